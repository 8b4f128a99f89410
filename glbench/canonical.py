"""Canonical JSON (RFC 8785), which all digests are taken over: the bytes of the package ``rfc8785``, several times as fast."""

from __future__ import annotations

import hashlib
from json.encoder import encode_basestring
from typing import Any

import rfc8785


def canonical_json(value: Any) -> bytes:
    """The one form that RFC 8785 gives a value of plain JSON types.

    Raises
    ------
    rfc8785.CanonicalizationError
        When JSON has no such value: NaN, an integer beyond 2**53, a key that is no string.
    """
    return _text(value).encode()


def canonical_sha256(value: Any) -> str:
    """SHA-256 [hex] of ``value`` (plain JSON values) in the one form that RFC 8785 gives it."""
    return hashlib.sha256(canonical_json(value)).hexdigest()


def _text(value: Any) -> str:
    """Python writes most values as RFC 8785 does; the package writes those that it may not."""
    kind = type(value)
    if kind is int and abs(value) < 2**53:
        return repr(value)
    if kind is float and value == 0.0:
        return "0"
    if kind is float and 1e-4 <= abs(value) < 1e16:  # here Python and ECMAScript change to exponents at the same places
        return repr(value).removesuffix(".0")
    if kind is str and value.isascii():
        return encode_basestring(value)
    if kind is dict and all(type(key) is str and key.isascii() for key in value):
        return "{" + ",".join([f"{encode_basestring(key)}:{_text(value[key])}" for key in sorted(value)]) + "}"
    if kind is list or kind is tuple:
        return "[" + ",".join(map(_text, value)) + "]"
    return rfc8785.dumps(value).decode()
