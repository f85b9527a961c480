"""A folder for PYTHONPATH: its sitecustomize.py takes away what Windows and macOS lack."""
