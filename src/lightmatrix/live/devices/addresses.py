"""Addresses of devices: KIND, KIND:ARGUMENT or KIND:ARGUMENT,option=value,option=value."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from lightmatrix.errors import InputError, MissingExtraError

# A comma separates options only if NAME= follows; any other comma is part of the argument, such as
# one in a folder's name.
_OPTION = re.compile(r",(?=[A-Za-z_][A-Za-z0-9_]*=)")


@dataclass(frozen=True)
class Address:
    """The parts of a device's address."""

    # The back end, such as "window" or "aravis".
    kind: str
    # Which of its devices; "" for the first one.
    argument: str = ""
    # Settings by name, as text.
    options: dict[str, str] = field(default_factory=dict)

    @classmethod
    def parse(cls, text: str) -> Address:
        """Split an address into its parts; an InputError if an option is given twice.

        >>> Address.parse("aravis:Basler-21,trigger=free,Gain=0")
        Address(kind='aravis', argument='Basler-21', options={'trigger': 'free', 'Gain': '0'})
        """
        device, *settings = _OPTION.split(text)
        kind, _, argument = device.partition(":")
        options: dict[str, str] = {}
        for setting in settings:
            name, _, value = setting.partition("=")
            if name in options:
                raise InputError(f"{text}: gives {name} twice", hint="give it once")
            options[name] = value
        return cls(kind, argument, options)

    def __str__(self) -> str:
        settings = (f",{name}={value}" for name, value in self.options.items())
        return self.kind + (f":{self.argument}" if self.argument else "") + "".join(settings)

    def check_options(self, known: Sequence[str], *, features: bool = False) -> None:
        """Refuse unknown options; with `features`, names with a capital pass to the camera."""
        for name in self.options:
            if name not in known and not (features and name[0].isupper()):
                offered = ", ".join(known) or "none"
                own = "; features of the camera itself begin with a capital" if features else ""
                raise InputError(
                    f"{self}: {self.kind} has no option {name!r}",
                    hint=f"its options are {offered}{own}",
                )

    def number(self, name: str, default: float) -> float:
        """The value of an option that must be a number above 0."""
        text = self.options.get(name)
        if text is None:
            return default
        try:
            value = float(text)
        except ValueError:
            value = 0.0
        if not 0 < value < float("inf"):
            raise InputError(f"{self}: {name} is {text!r}", hint=f"give {name}=NUMBER above 0")
        return value

    def choice(self, name: str, choices: Sequence[str], default: str) -> str:
        """The value of an option that must be one of a few words."""
        value = self.options.get(name, default)
        if value not in choices:
            raise InputError(
                f"{self}: {name} is {value!r}", hint=f"{name} can be {' or '.join(choices)}"
            )
        return value


@dataclass(frozen=True)
class AvailableDevice:
    """A device that is present: the address that opens it, and what it is in words."""

    address: str
    description: str


def missing_extra(extra: str, what: str, *, system: str | None = None) -> MissingExtraError:
    """The error for a back end whose packages are missing; `system` says what else to install."""
    hint = f"from the source folder: .venv/bin/pip install -e '.[{extra}]'"
    if system is not None:
        hint = f"{system}, then {hint}"
    return MissingExtraError(f"{what} cannot be used, a package is not installed", hint=hint)


def size_in_words(shape: tuple[int, ...]) -> str:
    """A shape with the width first, as monitors and cameras write it: "1024 x 768"."""
    return f"{shape[1]} x {shape[0]}"
