"""Blocks compressed by LZ4, as VTK's files may hold them, unpacked in plain Python.

The format: LZ4 Block Format, https://github.com/lz4/lz4/blob/dev/doc/lz4_Block_format.md
"""


def unpack_lz4(data: bytes) -> bytes:
    """The contents of one block: runs of bytes as they are, each followed by a repetition of earlier ones."""
    made, place = bytearray(), 0
    while place < len(data):
        token = data[place]
        count, place = _length(data, place + 1, token >> 4)
        made += data[place : place + count]
        place += count
        if place >= len(data):  # the last run has no repetition
            break
        back = data[place] | data[place + 1] << 8
        count, place = _length(data, place + 2, token & 15)
        count += 4
        piece = made[-back:][:count]
        made += (piece * -(-count // len(piece)))[:count]  # it may repeat what it has just made
    return bytes(made)


def _length(data: bytes, place: int, start: int) -> tuple[int, int]:
    """A length, which goes on in further bytes while these are full, and the place after it."""
    if start < 15:
        return start, place
    while True:
        start += data[place]
        place += 1
        if data[place - 1] < 255:
            return start, place
