"""Tables of columns: CSV or Parquet, by the suffix."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ampm.exceptions import InputError
from ampm.files import LARGEST_TABLE, check_columns, read_file, read_text

if TYPE_CHECKING:
    from numpy.typing import NDArray

SUFFIXES = (".csv", ".parquet")


def read_columns(path: Path) -> dict[str, NDArray[Any]]:
    """Read a table.

    Returns:
        Column name to array (N,); an empty cell is NaN, or None among texts.

    Raises:
        InputError: another suffix, or a file that is missing or no such table.
    """
    # Imported here: pyarrow is slow to load.
    import pyarrow.csv
    import pyarrow.parquet as pq

    check_suffix(path)
    try:
        if path.suffix == ".parquet":
            with pq.ParquetFile(io.BytesIO(read_file(path, LARGEST_TABLE))) as file:
                cells = file.metadata.num_rows * file.metadata.num_columns
                if cells > LARGEST_TABLE // 8:  # a few bytes may stand for many
                    raise InputError(f"{path} has {cells:,} cells; give at most {LARGEST_TABLE // 8:,}.")
                table = file.read()
        else:
            table = pyarrow.csv.read_csv(io.BytesIO(read_text(path, LARGEST_TABLE).encode()))
        check_columns(table.column_names, path)
        return {name: table[name].to_numpy() for name in table.column_names}
    except FileNotFoundError:
        raise InputError(f"there is no file {str(path)!r}; correct the name.") from None
    except InputError:
        raise
    except (OSError, ValueError) as error:  # pyarrow's errors are ValueErrors
        raise InputError(f"{path} cannot be read as a table ({error}); give a whole file.") from error


def check_suffix(path: Path) -> None:
    """Raise :class:`InputError` unless the path ends in one of :data:`SUFFIXES`."""
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path} must end in {' or '.join(SUFFIXES)}; the suffix chooses the format.")
