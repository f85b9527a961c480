"""What single samples of two recordings of one motion show: values, noise, low-passes and vibrations."""
