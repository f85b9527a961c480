"""What the papers claim, beside what comes out here: one study a system or table, one page of all.

It lives inside `replay` because, like the rest of it, it only feeds recordings and simulated phones through
the product; nothing of the product imports it. `claim.py` is what a study says, `studies.py` which there are,
`page.py` how they are kept and written down, `drawing.py` how they look.
"""
