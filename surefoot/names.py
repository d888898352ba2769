"""Names that users give to things of their own, and where the pages are that messages name.

Wherever a name is looked up, ``"module:name"`` imports the user's module first, which registers the name:
so that a command, a worker process and a specification read from JSON know it, too.
"""

from collections.abc import Collection
from importlib import import_module
from importlib.metadata import PackageNotFoundError, metadata


def plain_name(name: str) -> str:
    """Return a name without its module, which is imported.

    Raises:
        ValueError: If the module cannot be imported.

    >>> plain_name("json:mine"), plain_name("moment")
    ('mine', 'moment')
    """
    module, _, plain = name.rpartition(":")
    if module:
        try:
            import_module(module)
        except ImportError as error:
            raise ValueError(
                f"The module of '{name}' cannot be imported ({error}); it must be on the Python path of "
                "every process that uses it."
            ) from error
    return plain


def slug(name: str) -> str:
    """Return a name as it stands in column names.

    >>> slug("left/front_left")
    'left_front_left'
    """
    return name.replace("/", "_").replace("-", "_").replace(" ", "_")


def page(name: str) -> str:
    """Address of a page of this version's documentation, or its path in a checkout until there is one."""
    try:
        about = metadata("surefoot")
    except PackageNotFoundError:  # copied beside a program, and not installed
        return f"docs/{name}.md"
    home = about["Project-URL"].partition(", ")[2]
    here = "" if "/OWNER/" in home else f"{home}/blob/v{about['Version']}/"
    return f"{here}docs/{name}.md"


def check_new_name(what: str, name: str, taken: Collection[str]) -> None:
    """Raise TypeError or ValueError if a user's own thing cannot have a name."""
    if not isinstance(name, str):
        raise TypeError(f"The name of a {what} must be a str, got {type(name).__name__}.")
    if not name.strip() or ":" in name:
        raise ValueError(f"The name of a {what} must not be empty and must hold no ':', got {name!r}.")
    if name in taken:
        raise ValueError(f"There is a {what} '{name}' already; choose another name.")
