"""Compares the values of a message, as JSON, with an object that a library made of its bytes."""

import sys


def compare(place, expected, found):
    """Every value, by field name; numbers exactly, since both sides had the same bits."""
    if isinstance(expected, dict):
        for name, value in expected.items():
            compare(f"{place}.{name}", value, getattr(found, name))
    elif isinstance(expected, list):
        if len(expected) != len(found):
            sys.exit(f"{place}: {len(expected)} values were written, {len(found)} read")
        for index, value in enumerate(expected):
            compare(f"{place}[{index}]", value, found[index])
    elif expected != found:
        sys.exit(f"{place}: {expected!r} was written, {found!r} read")
