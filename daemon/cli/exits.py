"""The exit codes of every command, by meaning; 1 and 3 mean what each command's help says of them."""

NOT_MET = DAMAGED = REFUSED = 1
BAD_INPUT = 2
TOO_LITTLE = 3  # too few rests or attitudes for a calibration
NO_DAEMON = 4
VERDICT = 5  # that of --fail-on
NOT_SAVED = 74  # EX_IOERR of sysexits.h, a calibration that was made is not in the store
TRY_AGAIN = 75  # EX_TEMPFAIL of sysexits.h, a passing fault: the service manager starts it again
INTERRUPTED = 130
