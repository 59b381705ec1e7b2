"""Whether a MATLAB 5 file is built of whole elements of known kinds.

SciPy's reader takes the kinds of data on trust: one that there is not ends the whole process. An element is a tag (kind
and number of bytes) and its data; arrays hold elements, compressed ones hold one array.
"""

from __future__ import annotations

import zlib

_ARRAY, _COMPRESSED = 14, 15
_KINDS = {1, 2, 3, 4, 5, 6, 7, 9, 12, 13, _ARRAY, _COMPRESSED, 16, 17, 18}
_HEADER = 128
_DEEPEST = 100


def refuse_unsound(raw: bytes) -> None:
    """Raise ValueError, with one line, for a file whose elements are cut short or of no kind that there is."""
    order = {b"IM": "little", b"MI": "big"}.get(raw[126:128])
    if order is None:
        raise ValueError("no byte order in its header")
    _walk(raw, _HEADER, len(raw), order == "big", 0)


def _walk(raw: bytes, at: int, end: int, big: bool, depth: int) -> None:
    def word(k: int) -> int:
        return int.from_bytes(raw[k : k + 4], "big" if big else "little")

    if depth > _DEEPEST:
        raise ValueError(f"nested more than {_DEEPEST} deep")
    while at < end:
        if end - at < 8:
            raise ValueError(f"byte {at}: a tag cut short")
        kind, size, start = word(at), word(at + 4), at + 8
        if small := kind >> 16:  # up to four bytes of data within the tag
            kind, size, start = kind & 0xFFFF, small, at + 4
        if kind not in _KINDS or (small and (size > 4 or kind in (_ARRAY, _COMPRESSED))):
            raise ValueError(f"byte {at}: no kind of data has the number {kind}")
        if start + size > end:
            raise ValueError(f"byte {at}: {size} bytes said to follow, there are {end - start}")
        if kind == _ARRAY:
            _walk(raw, start, start + size, big, depth + 1)
        elif kind == _COMPRESSED:
            inner = zlib.decompress(raw[start : start + size])
            _walk(inner, 0, len(inner), big, depth + 1)
        at = at + 8 if small else start + size + (-size % 8 if kind != _COMPRESSED else 0)
