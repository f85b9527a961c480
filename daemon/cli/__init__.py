"""The command line: its entry, and the commands of the daemon and its store."""
