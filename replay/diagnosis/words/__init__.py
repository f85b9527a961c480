"""A comparison in words: names, units, sentences, equations and code to paste, what to record next."""
