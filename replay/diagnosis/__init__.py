"""The diagnosis of a recording from its file to its report."""
