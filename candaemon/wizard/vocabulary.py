"""What names in DBC files commonly mean: words of signals and messages, and the roles that they suggest.

A name is evidence, never proof: what a log can say is asked of the log.
"""

from __future__ import annotations

import re
from typing import Final

LONGEST_READ: Final = 64
"""Characters of a name in which words are looked for."""

_NUMBERED: Final = re.compile(r"\{(slot|point)[^}]*\}")
_WORD: Final = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")

_RATE: Final = "(rate|rt|speed|spd|velocity|vel|v)"
_SPEED: Final = "(vrel|v rel|v|vel|speed|spd|velocity|rate|rel speed|rel vel)"
_AHEAD: Final = "(long|longitudinal|lon|lgt|x)"
_ASIDE: Final = "(lat|lateral|y)"
_PLACE: Final = "(dist|distance|dst|pos|position|displacement|range|offset)"
_FAR: Final = "(range|rng|r|dist|distance|radial|closing|doppler)"
_ANY: Final = "(?:.* )?"

_ROLES: Final[tuple[tuple[str, str, int], ...]] = (
    # what is no quantity of an object goes first: it takes the name away from all that follows
    ("none", "(sigma|std|dev|rms|var|variance|unc|uncertainty|accuracy|err|error|fault|limit|offset)", 9),
    (
        "none",
        "(dx|dy|vx|vy|ax|x|y) (sigma|std|rms)|rcs|snr|amplitude|power|db|height|elevation|dz|z|vz|zeros|unused",
        9,
    ),
    ("none", f"(cos|cosine)|{_ANY}(cos|cosine) .*|.* (cos|cosine)", 9),
    ("checksum", "(checksum|chksum|chk|crc|cks|csum|checks)", 8),
    ("counter", "(rolling|alive|message|msg|scan|cycle|meas)? ?(counter|cntr|cnt|count|rolling count|alive)", 8),
    ("counter", "(rolling|alive) .*", 8),
    ("new", "(new|fresh|first seen)( track| object| obj| flag)?", 8),
    ("ax", f"{_ANY}(long|rel|range|rng|arel|x|radial)? ?(accel|acceleration|acc|arel|rel accel|a rel)( long| x)?", 6),
    ("ax", "(ax|arel long|a long|a rel long)", 7),
    ("ay", f"{_ANY}(lat (accel|acceleration|acc)|(accel|acc|arel) (lat|y)|ay)", 8),
    ("vy", f"{_ANY}(lat|lateral|y|transverse) {_RATE}", 8),
    ("vy", f"{_ANY}{_SPEED} {_ASIDE}|vy|vlat|latrate|yvel", 8),
    ("vx", f"{_ANY}{_AHEAD} {_RATE}", 8),
    ("vx", f"{_ANY}{_SPEED} {_AHEAD}|vx|vlong|xvel", 8),
    ("range_rate", f"{_ANY}({_FAR} (rate|rt|rat|speed|spd|velocity|vel|dot)|doppler|rdot|vr|vrad|rr|rangerate)", 8),
    ("range_rate", f"{_ANY}(radial v|v radial|v rad)", 8),
    ("range_rate", f"{_ANY}(rel|relative) {_RATE}|{_ANY}{_RATE} (rel|relative)|vrel|relv|relspeed|relvel", 7),
    ("range_rate", f"{_ANY}(speed|spd|velocity|vel|rate|gschw|geschw|geschwindigkeit)", 4),
    ("azimuth", f"{_ANY}(azimuth|azimut|azi|az|azmth|angle|ang|bearing|theta|phi|alpha|winkel)( .*)?", 7),
    ("heading", f"{_ANY}(orientation|heading|yaw)( angle| ang)?", 8),
    ("width", f"{_ANY}(width|wdth|wid)", 8),
    ("length", f"{_ANY}(length|len|lngth)", 8),
    ("y", f"{_ANY}{_ASIDE} {_PLACE}|latdist|ydist|ypos|yrel", 8),
    ("y", f"{_ANY}(dist|distance|dst|pos|position|d|rel) {_ASIDE}|dy|disty|posy|dlat|y", 8),
    ("x", f"{_ANY}{_AHEAD} {_PLACE}|longdist|xdist|xpos|xrel", 8),
    ("x", f"{_ANY}(dist|distance|dst|pos|position|d|rel) {_AHEAD}|dx|distx|posx|dlong|x", 8),
    ("range", f"{_ANY}(range|rng|radius|distance|dist|dst|abstand|entfernung)|r", 6),
    ("score", f"{_ANY}(prob( of)? (exist|existence)|existence|exist prob|exist|confidence|conf|score|quality)", 7),
    ("class", f"{_ANY}(class|type|obj class|object class)", 6),
    ("valid", f"{_ANY}(valid|validity|status|state|stat|measured|meas|tracked|detected|flag|mode|used)", 5),
    ("identity", f"{_ANY}(obj|object|track|trk|target|tgt|cluster)? ?(id|identity|identifier|ident|uid)", 6),
    ("identity", f"{_ANY}(index|idx|number|num|no|nr)", 4),
)
"""Role, what the name's words look like (joined by blanks, numbers left out), and how strongly that speaks for it."""

_COMPILED: Final = tuple((role, re.compile(rf"(?:{form})"), weight) for role, form, weight in _ROLES if weight)


def words(name: str) -> tuple[str, ...]:
    """Return the words of a name in lower case, without numbers: `CAN_TX_TRACK_RANGE` and `distX` alike."""
    found = _WORD.findall(_NUMBERED.sub(" ", name[:LONGEST_READ]))
    return tuple(each.lower() for each in found if not each.isdigit())


_PREFIXES: Final = frozenset(
    (
        *(
            "can",
            "tx",
            "rx",
            "track",
            "trk",
            "target",
            "tgt",
            "obj",
            "object",
            "radar",
            "rdr",
            "lrr",
            "flrr",
            "mrr",
            "srr",
        ),
        *(
            "lr",
            "sr",
            "det",
            "detection",
            "point",
            "pt",
            "cluster",
            "esr",
            "front",
            "f",
            "a",
            "b",
            "m",
            "s",
            "sig",
            "rear",
        ),
        *("corner", "cl", "lidar", "value", "val", "meas", "vsn", "fwd", "vision"),
    )
)
"""Words that say of what a signal is, not what it is."""
_SUFFIXES: Final = frozenset(
    ("trk", "track", "tr", "t", "rev", "obj", "object", "tgt", "target", "sig", "val", "value")
)
"""Likewise, at a name's end."""


def role_of(name: str) -> tuple[str, int]:
    """Return the role that a signal's name suggests, and how strongly, from 0 (not at all) to 9."""
    parts = list(words(name))
    best = ("", 0)
    while parts:
        text = " ".join(parts)
        for role, form, weight in _COMPILED:
            if weight > best[1] and form.fullmatch(text):
                best = (role, weight)
        if len(parts) > 1 and parts[0] in _PREFIXES:
            parts.pop(0)
        elif len(parts) > 1 and parts[-1] in _SUFFIXES:
            parts.pop()
        else:
            break
    return ("", 0) if best[0] == "none" else best


def angle_form(name: str) -> str:
    """Return what of an angle a signal's name says that it gives: `sine` or `slope`; empty: the angle."""
    told = set(words(name))
    return "sine" if told & {"sin", "sine"} else "slope" if told & {"tan", "tangent"} else ""


def says_absolute(name: str) -> bool:
    """Return whether a speed's name says that it is one over ground."""
    return bool(set(words(name)) & {"abs", "absolute", "ground"})


_POSITIVE: Final = r"(\+|positive|pos\.?) *(is |= *|to (the )?|values? (are |mean )?)*"
_RIGHT: Final = re.compile(_POSITIVE + r"(right|clockwise|cw)|right *(is |=)? *(\+|positive)", re.IGNORECASE)
_LEFT: Final = re.compile(_POSITIVE + r"(left|counter|ccw|anti)|left *(is |=)? *(\+|positive)", re.IGNORECASE)


def side_of(comment: str) -> int:
    """Return the side that a comment says is positive: 1 the left, −1 the right, 0 where it says nothing clear."""
    text = comment[:1000]
    return bool(_LEFT.search(text)) - bool(_RIGHT.search(text))
