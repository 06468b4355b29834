"""Tables of columns: CSV or Parquet, by the suffix."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ampm.exceptions import InputError

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
    if not path.exists():
        raise InputError(f"there is no file {str(path)!r}; correct the name.")
    if not path.is_file():  # to open a pipe would wait for its writer
        raise InputError(f"{path} is no regular file; give a table in a file.")
    try:
        table = pq.read_table(path) if path.suffix == ".parquet" else pyarrow.csv.read_csv(path)
        return {name: table[name].to_numpy() for name in table.column_names}
    except (OSError, ValueError) as error:  # pyarrow's errors are ValueErrors
        raise InputError(f"{path} cannot be read as a table ({error}); give a whole file.") from error


def check_suffix(path: Path) -> None:
    """Raise :class:`InputError` unless the path ends in one of :data:`SUFFIXES`."""
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path} must end in {' or '.join(SUFFIXES)}; the suffix chooses the format.")
