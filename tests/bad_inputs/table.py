"""Bad inputs as rows: a command line, and what was done to the files that it names.

Paths are relative to a folder of the row's own, into which `things` puts what the row names.
"""

import json
import os
import shutil
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Bad:
    """One command line that must be refused."""

    line: str
    changes: tuple["Change", ...] = ()
    text: str = ""
    """Stands in the error, so that the row is refused for its own reason."""

    @property
    def name(self):
        return " + ".join([self.line, *(change.name for change in self.changes)])


@dataclass(frozen=True)
class Change:
    """Something done to a file before the command runs."""

    path: str
    how: str
    apply: Callable[[Path], None]

    @property
    def name(self):
        return f"{self.path} {self.how}"


def bad(line, *changes, text=None):
    """A row; text: by default the name of the last file that was changed."""
    if text is None:
        text = Path(changes[-1].path).name if changes else ""
    return Bad(line, changes, text)


def rows(line, *changes):
    """A row for each change; of some changes at once, or of one whose error names something else
    than its file's name, a tuple that ends with the text of the error."""
    for change in changes:
        *several, text = change if isinstance(change, tuple) else (change, None)
        yield bad(line, *several, text=text)


def sweep(line, table):
    """A row for each value in each line of a table: `name value value ...`; `|` ends values that
    are several words. The flag is put for {} in the line, and must be in the error."""
    return [
        bad(
            line.replace("{}", f"--{name} {value}" if " " in value else f"--{name}={value}"),
            text=name,
        )
        for name, value in _entries(table)
    ]


def keys(line, path, table):
    """A row for each value in each line of a table: `key value value ...`, put into a TOML."""
    return [
        bad(line, toml(path, key, value), text=key.split(".")[-1]) for key, value in _entries(table)
    ]


def _entries(table):
    for entry in table.strip().splitlines():
        name, _, rest = entry.strip().partition(" ")
        for value in rest.split("|") if "|" in rest else rest.split():
            if value.strip():
                yield name, value.strip()


# -- changes ------------------------------------------------------------------------------------


def put(path, content):
    data = content if isinstance(content, bytes) else content.encode()

    def apply(file):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)

    start, number = content[:24], zlib.crc32(data) if len(data) > 24 else ""
    return Change(path, f"= {start!r} {number}".strip(), apply)


def swap(path, old, new):
    def apply(file):
        data = file.read_bytes()
        assert old.encode() in data, f"{file} has no {old!r}"
        file.write_bytes(data.replace(old.encode(), new.encode(), 1))

    return Change(path, f"{old!r} -> {new[:40]!r}", apply)


def toml(path, key, value):
    """Give a key of a TOML file another value; `table.key` adds a table where there is none."""
    table, _, name = key.rpartition(".")

    def apply(file):
        lines = file.read_text().splitlines()
        heads = [f"[{table}]", f"[[{table}]]"]
        at = next((i for i, line in enumerate(lines) if line in heads), None) if table else -1
        if at is None:
            lines += [f"[{table}]"]
            at = len(lines) - 1
        stop = next((i for i in range(at + 1, len(lines)) if lines[i].startswith("[")), len(lines))
        inside = [i for i in range(at + 1, stop) if lines[i].split("=")[0].strip() == name]
        for i in reversed(inside):
            del lines[i]
            while i < len(lines) and lines[i][:1] in (" ", "]"):  # values over several lines
                del lines[i]
        lines.insert(at + 1, f"{name} = {value}")
        file.write_text("\n".join(lines) + "\n")

    return Change(path, f"{key} = {value[:40]}", apply)


def values(path, **new):
    """Keys of a JSON file; `...` takes one away."""

    def apply(file):
        content = json.loads(file.read_text()) if file.exists() else {}
        content.update(new)
        content = {key: value for key, value in content.items() if value is not ...}
        file.write_text(json.dumps(content))

    return Change(path, str(new)[:60], apply)


def cut(path, share=0.5):
    return Change(
        path,
        f"cut to {share}",
        lambda file: file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)]),
    )


def flip(path, position, mask=0xFF):
    """Turn bits of one byte round; a position below 0 counts from the end."""

    def apply(file):
        data = bytearray(file.read_bytes())
        data[position] ^= mask
        file.write_bytes(data)

    return Change(path, f"byte {position} flipped", apply)


def drop(path):
    def apply(file):
        shutil.rmtree(file) if file.is_dir() else file.unlink()

    return Change(path, "missing", apply)


def link(path, target):
    """A link in place of a file or folder."""

    def apply(file):
        if file.exists():
            drop(path).apply(file)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.symlink_to(target)

    return Change(path, f"-> {target}", apply)


def pipe(path):
    """A named pipe in place of a file, which nobody writes."""

    def apply(file):
        file.unlink(missing_ok=True)
        os.mkfifo(file)

    return Change(path, "is a pipe", apply)


def holes(path, n_bytes=1 << 41):
    """A file that is longer than any disk, and takes none of it."""

    def apply(file):
        with file.open("ab") as handle:
            handle.truncate(n_bytes)

    return Change(path, f"has {n_bytes} bytes", apply)


def folder(path):
    def apply(file):
        if file.is_file():
            file.unlink()
        file.mkdir(parents=True, exist_ok=True)

    return Change(path, "is a folder", apply)


def npy(path, how, change):
    """Replace an .npy by what `change` makes of it."""

    def apply(file):
        np.save(file, change(np.load(file)))

    return Change(path, how, apply)


def npz(path, how, **changes):
    """Replace arrays of an .npz by what functions make of them; None takes one away."""

    def apply(file):
        with np.load(file) as stored:
            arrays = dict(stored)
        for name, change in changes.items():
            if change is None:
                del arrays[name]
            else:
                arrays[name] = change(arrays.get(name))
        np.savez(file, **arrays)

    return Change(path, how, apply)


def numbers(path, dtype, how, change):
    """Change the plain numbers of a chunk of a scene, as if they had been written so."""

    def apply(file):
        group = next(folder for folder in file.parents if folder.suffix == ".zarr") / "zarr.json"
        content = json.loads(group.read_text())
        content["attributes"].pop("checksums", None)
        group.write_text(json.dumps(content))
        array = np.fromfile(file, dtype=dtype)
        change(array).astype(dtype).tofile(file)

    return Change(path, how, apply)


def set_at(*pairs):
    """Function that puts values at flat positions."""

    def change(array):
        array = array.copy()
        for position, value in pairs:
            array.reshape(-1)[position] = value
        return array

    return change
