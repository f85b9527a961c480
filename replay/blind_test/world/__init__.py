"""The examiner's own world: days, phones, noise and the forward model of every effect."""
