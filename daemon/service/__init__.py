"""One running daemon's parts: the phone's session, the engine's thread, storage, subscribers."""
