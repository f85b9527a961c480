"""Thousands of recordings at once: calibrated and diagnosed on Dask, kept as Parquet, read as one fleet.

discovery.py finds recordings, worker.py is what a worker does with one, dask_jobs.py hands them out,
results_folder.py and parquet.py keep the results. The package summary describes the fleet. prior_file.py and
first_calibration.py give a new phone its first calibration from the fleet's prior. Needs the extra `fleet`.
"""
