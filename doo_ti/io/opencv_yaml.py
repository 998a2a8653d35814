"""Values in OpenCV FileStorage YAML, the format of rigs (§V-A).

OpenCV's own reader crashes on damaged files, so that its files are read without it; a matrix is a map ``rows, cols, dt, data``
with the tag ``!!opencv-matrix``.
"""

import numpy as np

KINDS = ("u", "c", "w", "s", "i", "f", "d")
"""Of numbers in a matrix of one channel."""


class DamagedError(ValueError):
    """Text that FileStorage does not write."""


def read_opencv_yaml(text: str):
    """The values of one document: dictionaries, lists, text, numbers, and matrices as arrays (rows, cols) in f64.

    Raises DamagedError for text that is not such YAML, and for damaged matrices. No other kind of object is created.
    """
    import yaml

    class Loader(yaml.SafeLoader):
        def compose_node(self, parent, index):
            if self.check_event(yaml.AliasEvent):  # FileStorage writes none, and they can expand without end
                raise DamagedError("an alias")
            return super().compose_node(parent, index)

        def matrix(self, node):
            return _matrix(self.construct_mapping(node, deep=True))

    Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", Loader.matrix)
    # FileStorage begins with a line that only OpenCV takes for a version of YAML, %YAML:1.0.
    lines = text.splitlines(keepends=True)
    body = "".join(lines[1:]) if lines and lines[0].startswith("%YAML") else text
    try:
        return yaml.load(body, Loader)
    except (yaml.YAMLError, RecursionError, OverflowError, TypeError, ValueError, AttributeError) as error:
        # The last three: a key that is a list, a date that is none.
        raise DamagedError((str(error) or type(error).__name__).splitlines()[0]) from None


def _matrix(entries: dict) -> np.ndarray:
    rows, columns, kind, data = (entries.get(key) for key in ("rows", "cols", "dt", "data"))
    for name, value in (("rows", rows), ("cols", columns)):
        if type(value) is not int or value < 1:
            raise DamagedError(f"{name} of a matrix is {value!r}")
    if kind not in KINDS:
        raise DamagedError(f"dt of a matrix is {kind!r}")
    if not isinstance(data, list) or len(data) != rows * columns:
        raise DamagedError(f"data of a matrix are not {rows} x {columns} numbers")
    return np.array([_number(value) for value in data]).reshape(rows, columns)


def _number(value) -> float:
    # YAML takes 1e3, without a point, for text.
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise DamagedError(f"{value!r} in a matrix is no number")
    try:
        return float(value)
    except (ValueError, OverflowError):
        raise DamagedError(f"{value!r} in a matrix is no number") from None
