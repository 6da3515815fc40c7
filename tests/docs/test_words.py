"""The list of refused words: what it finds, what it lets pass, and what may be exempt."""

import importlib
import re

import pytest

DOCS = "docs"  # apart, so that the check of links does not search for these pages
GOOD = """# Page

The two-way path is halfway to the limit. Look up the name; a look-up takes place once.
The value has two decimal places. Use `the second look` in place of the other.

    code may say which way it goes

See [the page](way.md).
"""


@pytest.fixture
def words(project_root, monkeypatch):
    monkeypatch.syspath_prepend(project_root / "tools")
    return importlib.import_module("check_words")


@pytest.fixture
def tree(project_root, tmp_path):
    """A small project with the table of this one, and nothing exempt."""
    for name in ("docs", "tools", "python/geraf2/ops", "cpp/src"):
        (tmp_path / name).mkdir(parents=True)
    table = (project_root / "tools" / "words.toml").read_text(encoding="utf-8")
    _write(tmp_path, "tools/words.toml", _exempt(table, "", ""))
    _write(tmp_path, f"{DOCS}/page.md", GOOD)
    return tmp_path


def _write(root, name, text):
    (root / name).write_text(text, encoding="utf-8")


def _exempt(table, folders, pages):
    """Replace the two lists at the end of words.toml."""
    head = table[: table.index("words = [")]
    return f"{head}words = [{folders}]\npages = [{pages}]\n"


def _set_exempt(root, folders="", pages=""):
    table = (root / "tools" / "words.toml").read_text(encoding="utf-8")
    _write(root, "tools/words.toml", _exempt(table, folders, pages))


def _run(words, root, capsys, *arguments):
    code = words.main(list(arguments), root)
    return code, capsys.readouterr().out.splitlines()


def test_allowed_phrases_and_code_pass(words, tree, capsys):
    assert _run(words, tree, capsys) == (0, [])


@pytest.mark.parametrize(
    ("sentence", "word"),
    [
        ("A second look finds more.", "second look"),
        ("There are two ways of it.", "ways"),
        ("The axis is told by the walls.", "told"),
        ("The report says it.", "says"),
        ("The delay is taken\noff each range.", "taken off"),
        ("It is taken for a wall.", "taken for"),
        ("Glints hang together.", "hang together"),
        ("The fit goes on.", "goes on"),
        ("That is what is left.", "what is left"),
        ("Each place of the mesh.", "place"),
        ("The figure is metal.", "figure"),
        ("The step is worth 0.02.", "worth"),
        ("These are ghosts of sparse sampling.", "ghosts of sparse"),
    ],
)
def test_a_refused_word_is_reported_with_its_line(words, tree, capsys, sentence, word):
    _write(tree, f"{DOCS}/bad.md", f"# Bad\n\n{sentence}\n")
    code, lines = _run(words, tree, capsys)
    assert code == 1
    assert any(re.fullmatch(rf"{DOCS}/bad\.md:3: {word} -> .+", line) for line in lines), lines


def test_comments_docstrings_messages_and_names_are_read(words, tree, capsys):
    _write(
        tree,
        "python/geraf2/ops/one.py",
        '"""Docstring.\n\nIt goes\non here.\n"""\n\n'
        'way = two_way_m = figure = "place"  # the last is no message\n'
        "# What stands\n# after the cut.\n"
        'MESSAGE = f"{way} is told"\n',
    )
    _write(
        tree,
        "cpp/src/two.cpp",
        "// Cells that hang\n// together.\nint place = 0; /* the way back */\n"
        'const char* text = "no place here";\n',
    )
    code, lines = _run(words, tree, capsys)
    assert code == 1
    assert [line.partition(" ->")[0] for line in lines] == [
        "cpp/src/two.cpp:1: hang together",
        "cpp/src/two.cpp:3: way",
        "cpp/src/two.cpp:4: place",
        "python/geraf2/ops/one.py:3: goes on",
        "python/geraf2/ops/one.py:7: way",
        "python/geraf2/ops/one.py:8: What stands",
        "python/geraf2/ops/one.py:10: told",
    ]


def test_a_long_page_and_a_long_site_are_refused(words, tree, capsys):
    _write(tree, f"{DOCS}/long.md", "word " * 1501)
    assert _run(words, tree, capsys) == (
        1,
        [f"{DOCS}/long.md: 1501 words, limit 1500: split or shorten it"],
    )
    _set_exempt(tree, pages=f'"{DOCS}/long.md"')
    assert _run(words, tree, capsys) == (0, [])
    for number in range(24):
        _write(tree, f"{DOCS}/page{number}.md", "word " * 1499)
    code, lines = _run(words, tree, capsys)
    assert code == 1
    assert re.fullmatch(r"docs: \d+ words on all pages, limit 35000", lines[0])


def test_the_list_of_exempt_files_can_only_shrink(words, tree, capsys):
    _write(tree, "python/geraf2/ops/one.py", "# Which way?\n")
    _set_exempt(tree, folders='"python/geraf2/ops/"')
    assert _run(words, tree, capsys) == (0, [])
    _write(tree, "python/geraf2/ops/one.py", "# Which direction?\n")
    assert _run(words, tree, capsys) == (
        1,
        ["tools/words.toml: python/geraf2/ops/ has no fault: it must leave the list"],
    )


def test_the_lists_that_are_printed_let_everything_pass(words, tree, capsys):
    _write(tree, "python/geraf2/ops/one.py", "# Which way?\n")
    _write(tree, f"{DOCS}/long.md", "place " * 1501)
    _, lines = _run(words, tree, capsys, "--list")
    table = (tree / "tools" / "words.toml").read_text(encoding="utf-8")
    _write(tree, "tools/words.toml", table[: table.index("words = [")] + "\n".join(lines) + "\n")
    assert _run(words, tree, capsys) == (0, [])


def test_long_sentences_are_reported_only_when_asked_for(words, tree, capsys):
    _write(tree, f"{DOCS}/long.md", f"# Page\n\nShort one. {'word ' * 40}end.\n")
    assert _run(words, tree, capsys) == (0, [])
    code, lines = _run(words, tree, capsys, "--sentences")
    assert code == 0
    assert lines == [f"{DOCS}/long.md:3: 41 words in a sentence: word word word word word word ..."]
