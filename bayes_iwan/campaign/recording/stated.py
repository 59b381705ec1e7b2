"""What a user's TOML file states: read whole, keys known, numbers finite; each fault is one line with the fix."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bayes_iwan.campaign.recording.records import CampaignError, shown
from bayes_iwan.errors import nearest, not_utf8

# a campaign is data from anywhere: nothing in it may cost more than it brings
LARGEST_TOML = 1_000_000  # bytes
LARGEST_NUMBER = 1e30  # in mm, N or s: far beyond any instrument, far below where squares overflow


def read_toml(path: Path, hint: str) -> dict[str, Any]:
    """A TOML file's tables. Raises CampaignError; `hint` says what should have been there."""
    try:
        if path.exists() and not path.is_file():
            raise CampaignError(f"{path}: not a file; {hint}")
        with path.open("rb") as file:
            raw = file.read(LARGEST_TOML + 1)
        if len(raw) > LARGEST_TOML:
            raise CampaignError(f"{path}: more than {LARGEST_TOML:,} bytes; records belong in files of their own")
        return tomllib.loads(raw.decode("utf-8-sig"))
    except FileNotFoundError:
        raise CampaignError(f"{path}: not found; {hint}") from None
    except OSError as error:
        raise CampaignError(f"{path}: cannot be read ({error.strerror})") from None
    except CampaignError:
        raise
    except RecursionError:
        raise CampaignError(f"{path}: its tables are nested too deep") from None
    except UnicodeDecodeError as error:
        raise CampaignError(f"{path} {not_utf8(error)}") from None
    except ValueError as error:  # of TOML, of an integer with thousands of digits
        raise CampaignError(f"{path}: not valid TOML: {' '.join(str(error).split())}") from None


def only(table: Mapping[str, object], known: set[str], where: str) -> None:
    """Refuse a key that is not known, naming the one that was probably meant."""
    for key in table:
        if key not in known:
            raise CampaignError(f"{where}: unknown key {shown(key)}{nearest(key, sorted(known))}")


def number_of(value: object, where: str) -> float:
    """A finite number. Raises CampaignError that begins with `where`."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST_NUMBER:
        raise CampaignError(f"{where} must be a finite number, not {shown(value)}")
    return float(value)


def positive(value: object, where: str) -> float:
    """A positive number of a size that instruments have. Raises CampaignError that begins with `where`."""
    number = number_of(value, where)
    if number <= 0:
        raise CampaignError(f"{where} must be positive, not {shown(value)}")
    if number < 1 / LARGEST_NUMBER:
        raise CampaignError(f"{where} = {number:g} is smaller than any instrument shows")
    return number
