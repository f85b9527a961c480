"""Claims of Stisen et al. 2015: how phones' sensors differ."""
