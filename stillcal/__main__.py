"""`python -m stillcal` is the command `stillcal`."""

from stillcal.daemon.cli.entry import main

main()
