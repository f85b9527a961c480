"""Claims of Collin et al. 2019: error models, Allan variance, dead reckoning, motion modes."""
