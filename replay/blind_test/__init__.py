"""The blind proof: recordings with concealed effects, sealed keys, answers by others, and their scores.

Nothing here shares a formula with the diagnosis it examines, nor may import it; `answering` alone calls it.
"""
