"""Studies that compare the claims of four papers with our own results, and the page that shows them all.

The package lies inside `replay` because it only feeds recordings and simulated phones through the product, as
the rest of `replay` does; nothing of the product imports it. `claim.py` defines a claim with its verdict and
its kind of evidence, `registry.py` names the studies, `evaluate.py` runs them, `page.py` keeps the results
and writes the page, `drawing.py` holds the style of the figures. `methods` holds those methods of the papers
that only the studies need.
"""
