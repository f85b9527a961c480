"""The local socket at which the daemon answers (varlink)."""
