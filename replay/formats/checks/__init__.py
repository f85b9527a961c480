"""Whether a recording's units and axes can be what they are said to be."""
