"""Many recordings of many robots: one diagnosis each on a Dask cluster, one table, one page."""
