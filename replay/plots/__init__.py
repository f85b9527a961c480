"""Figures of a recording and of a store: attitudes, residuals, history, Allan curves (extra `report`)."""
