"""A simulation's own configuration, corrected by what a diagnosis found: `--fix-for TOOL FILE`.

`fixers.FIXERS` lists the tools. Each takes the text of the configuration and the findings of a diagnosis
(JSON schema 2), and returns the text with the differences in it, what was changed, and what it cannot hold.
"""
