"""Texts that people give, in the one encoding that is read."""

from pathlib import Path


class NotUTF8(ValueError):  # noqa: N818
    """What was named is a text in another encoding, or none. The message is the one line a user reads, without the file."""


# First bytes of what people give in place of a text -> what it is.
_COMPRESSED = {b"\x1f\x8b": "gzip", b"PK\x03\x04": "zip", b"BZh": "bzip2", b"\xfd7zXZ": "xz", b"(\xb5/\xfd": "zstd"}


def read_text(path: str | Path) -> str:
    """The text of a file in UTF-8, with a byte order mark or without; line ends as they are.

    Raises:
        NotUTF8: it is in another encoding, compressed, or a folder.
        OSError: it cannot be read.
    """
    if Path(path).is_dir():
        raise NotUTF8("it is a folder, allowed: a file")
    content = Path(path).read_bytes()
    for start, name in _COMPRESSED.items():
        if content.startswith(start):
            raise NotUTF8(f"it is compressed ({name}), allowed: a text in UTF-8; unpack it")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        is_wide = content[:2] in (b"\xff\xfe", b"\xfe\xff")
        line = content.count(b"\n", 0, error.start) + 1
        found = "it is in UTF-16" if is_wide else f"line {line} is not in UTF-8"
        raise NotUTF8(f"{found}, allowed: UTF-8; save it as UTF-8") from error
    if "\0" in text:
        raise NotUTF8("it holds zero bytes, as UTF-16 does, allowed: UTF-8; save it as UTF-8")
    return text
