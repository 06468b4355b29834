"""Tables as CSV or Parquet."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray


def write_columns(columns: Mapping[str, NDArray[Any]], path: Path) -> None:
    """Write columns (N,) as Parquet or CSV, by the suffix; floats keep every bit, NaN is an empty cell."""
    # Imported here: 'ampm plan' writes nothing by default, and starts faster without.
    import pyarrow as pa
    import pyarrow.csv
    import pyarrow.parquet as pq

    table = pa.table({name: pa.array(column, from_pandas=True) for name, column in columns.items()})
    if path.suffix == ".parquet":
        pq.write_table(table, path, compression="zstd")
    else:
        pyarrow.csv.write_csv(table, path)
