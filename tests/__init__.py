"""The tests, in the folders of what they test; helpers that several share live in `tests.support`."""
