"""What stands in place of a text is named, whatever it is; a text in UTF-8 is read as it is."""

import bz2
import gzip
import lzma

import pytest

from qjrl.text_file import NotUTF8, read_text


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (gzip.compress(b"x,y\n1,2\n"), "compressed (gzip)"),
        (bz2.compress(b"x,y\n"), "compressed (bzip2)"),
        (lzma.compress(b"x,y\n"), "compressed (xz)"),
        (b"PK\x03\x04rest of a spreadsheet", "compressed (zip)"),
        ("x\n1".encode("utf-16"), "UTF-16"),
        (b"x,y\n\xb5,2\n", "line 2 is not in UTF-8"),
        (b"x\0,\0", "zero bytes"),
    ],
    ids=["gzip", "bzip2", "xz", "zip", "utf-16", "latin-1", "zeros"],
)
def test_what_is_no_text_in_utf8_is_named_on_one_line(tmp_path, content, words):
    (tmp_path / "file.csv").write_bytes(content)
    with pytest.raises(NotUTF8) as error:
        read_text(tmp_path / "file.csv")
    assert words in str(error.value) and "allowed: " in str(error.value) and "\n" not in str(error.value)


def test_a_folder_is_named(tmp_path):
    with pytest.raises(NotUTF8, match="it is a folder, allowed: a file"):
        read_text(tmp_path)


def test_a_text_is_read_as_it_is_without_its_byte_order_mark(tmp_path):
    (tmp_path / "file.yaml").write_bytes(b"\xef\xbb\xbfgrad: 5\xc2\xb0\r\n")
    assert read_text(tmp_path / "file.yaml") == "grad: 5°\r\n"
