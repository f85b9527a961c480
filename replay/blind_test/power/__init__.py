"""How detectable an effect is: d' of rests, of turns and of what samples show, and sizes for a wanted d'."""
