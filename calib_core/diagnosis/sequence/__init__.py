"""What samples and stamps say of their own order, place and code: effects without a name."""
