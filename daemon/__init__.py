"""The only code that touches the world: settings, sources, store, socket, command line."""
