"""Changes of the arrays of npz files and the columns of Parquet: shapes, types, values, and the archive around them."""

import io
import random
import warnings
import zipfile
from pathlib import Path

import numpy as np

HUGE = (1e300, -1e300, 1e-300, 1e30, 1e-30, 1e6, -1e6, 0.0, -1.0, np.nan, np.inf, -np.inf, 2.0**31, 2.0**63, 5e-324)
SHAPES = {
    "without its first axis": lambda a: a[0],
    "one axis more": lambda a: a[None],
    "axes swapped": lambda a: a.T,
    "flat": lambda a: a.ravel(),
    "empty": lambda a: a[:0],
    "first row only": lambda a: a[:1],
    "one row less": lambda a: a[:-1],
    "one column less": lambda a: a[..., :-1],
    "one column more": lambda a: np.concatenate([a, a[..., :1]], axis=-1),
    "twice as many rows": lambda a: np.concatenate([a, a]),
    "no dimension": lambda a: a.ravel()[0],
    "many dimensions": lambda a: a.reshape((1,) * 20 + a.shape),
    "last axes swapped": lambda a: np.swapaxes(a, -1, -2),
    "rows backwards": lambda a: a[::-1],
    "in columns first": np.asfortranarray,
    "zeros": np.zeros_like,
    "the same row": lambda a: np.broadcast_to(a[:1], a.shape),
    "the middle axis halved": lambda a: a[:, ::2],
}
TYPES = ("f4", "f2", "i4", "i1", "u8", "?", "c16", "U12", "S6", "O", "M8[s]", ">f8", "g", "V4", "i8,f4")


def spoilt_values(array: np.ndarray, chance: random.Random) -> tuple[np.ndarray, str]:
    """A copy with one or all of its values replaced or scaled, and what was done."""
    if array.dtype.kind not in "fiub":
        return spoilt_type(array, chance)
    value, how = chance.choice(HUGE), chance.choice(("one", "one", "all", "times", "row"))
    changed = np.array(array, dtype=np.float64)
    with np.errstate(all="ignore"):
        if how == "times":
            changed = changed * value
        elif changed.size:
            at = chance.randrange(changed.size)
            if how == "one":
                changed.reshape(-1)[at] = value
            elif how == "row" and changed.ndim:
                changed[at % len(changed)] = value
            else:
                changed[...] = value
        if array.dtype.kind in "iub":
            changed = changed.astype(array.dtype)
    return changed, f"{how} {value:g}"


def spoilt_shape(array: np.ndarray, chance: random.Random) -> tuple[np.ndarray, str]:
    name = chance.choice(sorted(SHAPES))
    try:
        return SHAPES[name](array), name
    except (IndexError, ValueError, TypeError):
        return array[None], "one axis more"


def spoilt_type(array: np.ndarray, chance: random.Random) -> tuple[np.ndarray, str]:
    kind = chance.choice(TYPES)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return array.astype(kind), f"dtype {kind}"
    except (TypeError, ValueError):
        return array.astype("O"), "dtype O"


def spoil_npz(path: Path, chance: random.Random) -> tuple[str, str]:
    """Change one thing about a good npz file; returns its kind and what it is."""
    with np.load(path) as file:
        arrays = dict(file)
    key = chance.choice(sorted(arrays))
    way = chance.choice(
        ("values",) * 6 + ("shape",) * 4 + ("type",) * 2 + ("drop", "rename", "twice", "header", "member", "foreign")
    )
    if way in ("values", "shape", "type"):
        change = {"values": spoilt_values, "shape": spoilt_shape, "type": spoilt_type}[way]
        arrays[key], described = change(arrays[key], chance)
        _write_npz(path, arrays)
        return "values" if way == "values" else "structure", f"{key}: {described}"
    if way == "drop":
        del arrays[key]
    elif way == "rename":
        arrays[chance.choice((key + "_", key.upper(), key[:-1], "x" + key, "$" + key, key.replace("_mm", "_m")))] = arrays.pop(
            key
        )
    elif way == "foreign":
        other = chance.choice(sorted(arrays))
        arrays[key], way = arrays[other], f"{other} in its place"
    _write_npz(path, arrays)
    if way in ("twice", "header", "member"):
        way = _spoil_archive(path, key, chance)
    return "structure", f"{key}: {way}"


def _write_npz(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """What np.savez writes, without the time, so that the same case is the same file."""
    with zipfile.ZipFile(path, "w") as archive:
        for key, array in arrays.items():
            member = io.BytesIO()
            np.lib.format.write_array(member, np.asanyarray(array))
            archive.writestr(zipfile.ZipInfo(f"{key}.npy"), member.getvalue())


def _spoil_archive(path: Path, key: str, chance: random.Random) -> str:
    """Replace, repeat or add a member of the archive."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name, good = f"{key}.npy", members[f"{key}.npy"]
    headers = {
        "header not closed": b"\x93NUMPY\x01\x00\x10\x00{'descr': '<f8', ",
        "header of 4 GB": b"\x93NUMPY\x02\x00\xff\xff\xff\xff{",
        "header of version 9": good[:6] + b"\x09\x00" + good[8:],
        "header that calls": good.replace(b"'<f8'", b"f(8)", 1),
        "header of 1e12 numbers": _with_shape(good, (10**12,)),
        "header of negative shape": _with_shape(good, (-1, 3)),
        "header of huge shapes": _with_shape(good, (2**40, 2**40)),
        "half a member": good[: len(good) // 2],
        "no content": b"",
        "content twice": good + good,
        "header of no shape": good.replace(b"'shape'", b"'shabe'", 1),
        "header of text": good.replace(b"'<f8'", b"'<U9'", 1),
        "header of objects": good.replace(b"'<f8'", b"'|O' ", 1),
    }
    described = chance.choice(sorted(headers))
    way = chance.choice(("instead", "instead", "beside", "elsewhere", "method"))
    packed = chance.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA))
    written = [(member, headers[described] if member == name and way == "instead" else content)
               for member, content in members.items()]
    if way == "beside":
        written.append((name, headers[described]))
    elif way == "elsewhere":
        written.append((chance.choice(("../" + name, "/tmp/" + name, "a/" + name, "vertices_mm", "\x1b[2J.npy")), good))
    with warnings.catch_warnings(), zipfile.ZipFile(path, "w") as archive:
        warnings.simplefilter("ignore")  # that a name is there twice
        for member, content in written:
            archive.writestr(zipfile.ZipInfo(member), content, packed)
    if way == "method":
        content = path.read_bytes().replace(
            b"PK\x01\x02\x14\x00\x14\x00\x00\x00\x00\x00", b"PK\x01\x02\x14\x00\x14\x00\x01\x00\x63\x00"
        )
        path.write_bytes(content)
    return {"instead": described, "beside": f"twice, {described}"}.get(way, way)


def _with_shape(member: bytes, shape: tuple) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return file.getvalue() + member[-64:]


def spoil_parquet(path: Path, chance: random.Random) -> tuple[str, str]:
    """Change one column of a table; returns the change's kind and what it is. The file's metadata stay as they were."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pq.read_table(path)
    column = chance.randrange(table.num_columns)
    name, metadata = table.column_names[column], table.schema.metadata
    way = chance.choice(("values",) * 5 + ("type",) * 2 + ("drop", "rename", "twice", "rows", "null", "metadata", "list"))
    kind, described = "structure", way
    if way in ("values", "type"):
        array = table.column(column).to_numpy()
        new, described = (
            (spoilt_values if way == "values" else spoilt_type)(array, chance)
            if array.dtype.kind in "fiub"
            else (array, "same")
        )
        kind = "values" if way == "values" else kind
        table = table.set_column(column, name, _column(new))
    elif way == "drop":
        table = table.remove_column(column)
    elif way in ("rename", "twice"):
        names = list(table.column_names)
        names[column] = chance.choice(names) if way == "twice" else name + "_"
        table = table.rename_columns(names)
    elif way == "rows":
        rows = list(range(table.num_rows))
        described = chance.choice(("rows shuffled", "a row twice", "a row less", "no rows"))
        chance.shuffle(rows)
        table = table.take(
            {"rows shuffled": rows, "a row twice": [*rows, rows[0]], "a row less": rows[1:], "no rows": []}[described]
        )
    elif way == "null":
        table = table.set_column(column, name, pa.nulls(table.num_rows, table.schema.field(column).type))
    elif way == "list":
        table = table.set_column(column, name, pa.array([[1.0]] * table.num_rows))
    if way == "metadata" and metadata:
        key = chance.choice(sorted(metadata))
        metadata = {**metadata, key: chance.choice((b"", b"\xff\xfe", b"x", metadata[key] + b"0"))}
        described = f"metadata {key.decode(errors='replace')}"
    pq.write_table(table.replace_schema_metadata(metadata), path, write_page_checksum=chance.random() < 0.5)
    return kind, f"{name}: {described}"


def _column(array: np.ndarray):
    import pyarrow as pa

    try:
        return pa.array(array)
    except (pa.ArrowException, TypeError, ValueError):
        return pa.array([str(value) for value in array])
