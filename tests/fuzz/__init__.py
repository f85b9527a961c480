"""Parsers tried with bytes that nobody meant: `make fuzz`."""
