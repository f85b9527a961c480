"""How likely residuals are: noise covariances, likelihood, Bayes factors and cross-validation."""
