"""`stillcal watch`: a running daemon in the terminal."""
