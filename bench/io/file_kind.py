"""What a file that can't be read as weights is in truth: a web page, a Git LFS pointer, an archive ..."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

_HEAD = 1024
_PAGES = (b"<!doctype html", b"<html", b"<head", b"<script")
_ARCHIVES = {b"\x1f\x8b": "a gzip archive", b"7z\xbc\xaf": "a 7z archive", b"Rar!": "a rar archive"}


def what_it_is(path: Path) -> str:
    """For a file that a network's reader refused: what it is and what to do, or "" where that is not known.

    Raises ``OSError`` where it can't be opened.
    """
    with path.open("rb") as file:
        head = file.read(_HEAD)
    start = head.removeprefix(b"\xef\xbb\xbf").lstrip().lower()
    if not head:
        return "it is empty. Fetch it again"
    if start.startswith(_PAGES):
        return (
            "it is a web page (HTML), saved in place of the file. Open its address in a browser and save the file "
            "itself; on GitHub and Hugging Face that is the link `download`, with /raw/ or /resolve/ in it"
        )
    if start.startswith(b"version https://git-lfs"):
        size = re.search(rb"\nsize (\d{1,15})\b", head)
        of_size = f" to a file of {max(1, round(int(size[1]) / 1e6)):,} MB" if size else ""
        return (
            f"it is a Git LFS pointer{of_size}, which was not fetched. Run `git lfs pull` in its repository, or "
            "download the file itself"
        )
    for magic, name in _ARCHIVES.items():
        if head.startswith(magic):
            return f"it is {name}. Unpack it, and give the file of weights inside"
    if head[257:262] == b"ustar":
        return "it is a tar archive. Unpack it, and give the file of weights inside"
    if zipfile.is_zipfile(path) and not _is_of_torch(path):
        return "it is a zip archive. Unpack it, and give the file of weights inside"
    if head[8:9] == b"{" and int.from_bytes(head[:8], "little") < path.stat().st_size:
        return "it is a safetensors file. Save it with torch.save(safetensors.torch.load_file(FILE), 'net.pth')"
    if _is_text(head):
        return f"it is text, which begins {head[:60].decode(errors='replace')!r}. Fetch the file of weights itself"
    return ""


def _is_of_torch(path: Path) -> bool:
    """Whether a zip archive is one of torch.save, whole or not."""
    try:
        with zipfile.ZipFile(path) as archive:
            return any(name.endswith("/data.pkl") for name in archive.namelist())
    except Exception:  # a damaged one, which zipfile says in many ways
        return True


def _is_text(head: bytes) -> bool:
    try:
        return head.decode("utf-8").replace("\n", "").replace("\r", "").replace("\t", "").isprintable()
    except UnicodeDecodeError:
        return False
