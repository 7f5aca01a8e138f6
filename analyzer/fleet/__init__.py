"""A fleet's captures as one lake of tables: Delta Lake holds them, Dask does the work, DuckDB answers questions.

    captures anywhere (fsspec) -> tasks -> workers (Dask): rows as Parquet files -> one commit a batch -> tables of the lake

Everything here needs the extra `servotap[fleet]`, and nothing else of the project imports it.
"""
