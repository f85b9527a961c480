"""Effects on bias and scale that vary slowly: regressors, effects, search, naming and findings."""
