"""`make faults`: what kills, full disks, hostile clients and a bad line do to the daemon, counted."""
