"""The pure core: arrays in, values out; no clock, no files, no sockets, no logging."""
