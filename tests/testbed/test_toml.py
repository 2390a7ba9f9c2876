"""TOML of plain data: what is written can be read."""

import tomllib

from testbed.toml import toml_text


def test_every_letter_comes_back():
    text = "".join(map(chr, range(0x80))) + "é😀"
    table = {text: text, "list": [text]}
    assert tomllib.loads(toml_text(table)) == table
