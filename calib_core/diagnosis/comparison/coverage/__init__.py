"""What each of two recordings can show: what could be looked for, how small, and why the rest could not."""
