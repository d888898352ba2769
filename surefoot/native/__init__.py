"""The code in C: how a library is compiled, found and loaded, whatever is in it; see docs/native.md.

A package with C has a folder ``native`` with its headers and a ``library.c`` that includes them. Nothing here
knows which packages have one.
"""

from surefoot.native.build import Sources, compiler
from surefoot.native.library import ADDRESS, Library, Native, places_at, require
from surefoot.native.records import Record, c_header, leaves_of, rebuilt
from surefoot.native.threads import call_for_many, cores

__all__ = [
    "ADDRESS",
    "Library",
    "Native",
    "Record",
    "Sources",
    "c_header",
    "call_for_many",
    "compiler",
    "cores",
    "leaves_of",
    "places_at",
    "rebuilt",
    "require",
]
