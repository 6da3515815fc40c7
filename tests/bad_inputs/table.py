"""Bad inputs as rows: a command line, and what was done to the files that it names.

Paths are relative to a folder of the row's own, into which `things` puts what the row names.
"""

import json
import os
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tomli_w


class Change(NamedTuple):
    """Something done to a file before the command runs."""

    path: str
    apply: Callable[[Path], object]


class Bad(NamedTuple):
    """One command line that must be refused, by an error that holds `text`."""

    line: str
    changes: tuple[Change, ...]
    text: str


def bad(line, *changes, text=None):
    """A row; text: by default the name of the last file that was changed."""
    if text is None:
        text = Path(changes[-1].path).name if changes else ""
    return Bad(line, changes, text)


def rows(line, *changes):
    """A row for each change; of some changes at once, or of one whose error names something else
    than its file's name, a tuple that ends with the text of the error."""
    for change in changes:
        *several, text = (change, None) if isinstance(change, Change) else change
        yield bad(line, *several, text=text)


def puts(line, path, *contents):
    """A row for each content of a file."""
    return rows(line, *(put(path, content) for content in contents))


def table(text):
    """Cells of each line of a text."""
    return [entry.strip().split("|") for entry in text.strip().splitlines()]


def sweep(line, text):
    """A row for each value of `name|value|value ...`; the flag is put for {} in the line."""
    for name, *of in table(text):
        for value in of:
            flag = f"--{name} {value}" if " " in value else f"--{name}={value}"
            yield bad(line.replace("{}", flag), text=name)


def keys(line, path, text):
    """A row for each value of `key|value|value ...`, put into a TOML file."""
    for key, *of in table(text):
        for value in of:
            yield bad(line, toml(path, key, value), text=key.split(".")[-1])


def edit(path, change):
    """Bytes of a file, as a function makes them."""
    return Change(path, lambda file: file.write_bytes(change(file.read_bytes())))


def put(path, content):
    def apply(file):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content if isinstance(content, bytes) else content.encode())

    return Change(path, apply)


def swap(path, old, new):
    return edit(path, lambda data: data.replace(old.encode(), new.encode(), 1))


def cut(path, share=0.5):
    return edit(path, lambda data: data[: int(share * len(data))])


def flip(path, at):
    """Turn the bits of one byte round."""
    return edit(path, lambda data: data[:at] + bytes([data[at] ^ 0xFF]) + data[at + 1 :])


def toml(path, key, value):
    """Give a key of a TOML file another value; `table.key` adds a table where there is none."""

    def apply(file):
        content = tomllib.loads(file.read_text())
        target, (*above, name) = content, key.split(".")
        for one in above:
            target = target.setdefault(one, {})
            target = target[0] if isinstance(target, list) else target
        target |= tomllib.loads(f"{name} = {value}")
        file.write_text(tomli_w.dumps(content))

    return Change(path, apply)


def values(path, *inside, **new):
    """Keys of a JSON file, or of an object in it; `...` takes one away."""

    def apply(file):
        content = json.loads(file.read_text()) if file.exists() else {}
        target = content
        for name in inside:
            target = target[name]
        target |= new
        for name in [name for name, value in new.items() if value is ...]:
            del target[name]
        file.write_text(json.dumps(content))

    return Change(path, apply)


def drop(path):
    return Change(path, lambda file: shutil.rmtree(file) if file.is_dir() else file.unlink())


def link(path, target):
    """A link in place of a file or folder."""

    def apply(file):
        if file.exists():
            drop(path).apply(file)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.symlink_to(target)

    return Change(path, apply)


def pipe(path):
    """A named pipe in place of a file, which nobody writes."""
    return Change(path, lambda file: (file.unlink(missing_ok=True), os.mkfifo(file)))


def holes(path):
    """A file that is longer than any disk, and takes none of it."""
    return Change(path, lambda file: (file.touch(), os.truncate(file, 1 << 41)))


def npy(path, change):
    return Change(path, lambda file: np.save(file, change(np.load(file))))


def npz(path, name, change):
    """Replace an array of an .npz by what a function makes of it; None takes it away."""

    def apply(file):
        with np.load(file) as stored:
            arrays = dict(stored)
        array = arrays.pop(name)
        np.savez(file, **arrays, **({name: change(array)} if change else {}))

    return Change(path, apply)


def numbers(path, dtype, change):
    """Change the plain numbers of a chunk of a scene, as if they had been written so."""

    def apply(file):
        group = next(folder for folder in file.parents if folder.suffix == ".zarr") / "zarr.json"
        values(path, "attributes", checksums=...).apply(group)
        change(np.fromfile(file, dtype=dtype)).astype(dtype).tofile(file)

    return Change(path, apply)


def set_at(position, value):
    """Function that puts a value at a flat position."""

    def change(array):
        array = array.copy()
        array.reshape(-1)[position] = value
        return array

    return change


def in_mm(array):
    return 1000 * array
