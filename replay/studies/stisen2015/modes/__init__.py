"""Recognisers tested on people and devices they were not trained on (Stisen et al. 2015, Figures 5 to 12)."""
