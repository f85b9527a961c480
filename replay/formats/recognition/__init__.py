"""What a recording is, by its content: which format, which columns, which sensors."""
