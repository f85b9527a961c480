"""Which columns of a table are time, acceleration, rate and temperature, by how people name them."""
