"""What all effects share: residuals, noise models, likelihood, cross-validation, the records of an answer."""
