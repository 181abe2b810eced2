"""Texts that people give, in the one encoding that is read."""

from pathlib import Path


class NotUTF8(ValueError):  # noqa: N818
    """The bytes are a text in another encoding, or none. The message is the one line a user reads, without the file."""


def read_text(path: str | Path) -> str:
    """The text of a file in UTF-8, with a byte order mark or without; line ends as they are.

    Raises:
        NotUTF8: it is in another encoding.
        OSError: it cannot be read.
    """
    content = Path(path).read_bytes()
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
