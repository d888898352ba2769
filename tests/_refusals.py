"""Tables of what is refused: one test for each, whose rows are what is given and the words of the error."""

import re
from collections.abc import Callable
from typing import Any

import pytest


def refusals(
    use: Callable[..., Any], *rows: tuple[Any, ...], error: type[Exception] = ValueError, plain: bool = False
) -> Any:
    """Make the test of a table: each row has the arguments of ``use``, and a pattern or the plain words."""

    @pytest.mark.parametrize("row", rows, ids=[row[-1] for row in rows])
    def test(row: tuple[Any, ...]) -> None:
        *arguments, message = row
        with pytest.raises(error, match=re.escape(message) if plain else message):
            use(*arguments)

    return test
