"""What calibration, clustering and interpolation give back (Stisen et al. 2015, 5, Figures 13 to 15)."""
