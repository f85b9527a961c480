"""Thousands of recordings at once: calibrated and diagnosed on Dask, kept as Parquet, read as one fleet.

listing.py finds recordings, work.py is what a worker does with one, running.py hands them out, kept.py keeps
what came of them. devices.py, spread.py, outliers.py and clusters.py read the fleet; shorten.py shows what a
prior from it is worth to a new phone. Needs the extra `fleet`.
"""
