"""What the first samples of a table of unknown make decide: its time and its units."""
