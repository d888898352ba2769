"""What an extra of the package brings is asked for by its name."""


def not_installed(name: str, missing: ImportError, extra: str) -> ImportError:
    """Return the error that says what to install for a module or function; one that says so already stays."""
    if "surefoot" in str(missing):
        return missing
    return ModuleNotFoundError(
        f'{name} needs a package that is not installed ({missing}): pip install "surefoot[{extra}]".',
        name=missing.name,
    )
