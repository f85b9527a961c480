"""The protocol between a phone and the daemon: binary frames and text lines."""
