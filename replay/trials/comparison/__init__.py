"""Given simulations, judged and counted: is each told what it lacks, has wrong, or has for nothing?"""
