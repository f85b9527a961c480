"""Two sensors on one motion: what one reads less what the other reads holds no motion.

All of the recording is judged, moved or not. The difference of the readings is the one's own error, as far as
the other has none; everything else is as in a recording of rests: the same effects, the same noise, the same
search. In the order of the work: `turns` (with `delay`) puts what motion shows into what the other reads,
`pair_residuals` cuts the difference into bins, `search` looks for slow effects there (with `motion`),
`measured` fits what was found beside bias, scale and misalignment, `compare` states it.
"""
