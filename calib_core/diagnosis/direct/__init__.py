"""Effects that samples, values and time stamps show directly, one file each."""
