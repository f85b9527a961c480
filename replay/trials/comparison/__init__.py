"""Given simulations, judged and counted: each is told what it lacks, has wrong, or has for nothing."""
