"""Text that holds readings, but not as cells of a table: it is copied into cells, line by line."""
