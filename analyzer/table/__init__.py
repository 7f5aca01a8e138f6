"""Tables of decoded traffic: for spreadsheets, data frames and databases.

    pipeline -> Rows (a sink) -> Recorded -> Long or Wide -> CSV, Parquet, Excel, Arrow

Columns come from the layouts alone (`columns`). A table is known as a whole only when all traffic was seen: which columns it
has, whether its times have dates. So rows wait in a file without a name, and memory does not grow with the input.
"""
