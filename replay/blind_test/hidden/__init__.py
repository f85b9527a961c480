"""What is hidden beyond the catalogue: real effects without a name there, and shapes almost named."""
