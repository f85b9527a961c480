"""Where the daemon publishes what it knows: an MCAP file, an input device, the chip's own registers."""
