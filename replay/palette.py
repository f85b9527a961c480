"""The colours of all figures and pages: told apart by the colour-blind too (Okabe and Ito 2008)."""

BLUE, RED, GREEN, ORANGE, PURPLE = "#0072b2", "#d55e00", "#009e73", "#e69f00", "#cc79a7"
