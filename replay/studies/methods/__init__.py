"""The papers' methods that only the studies use."""
