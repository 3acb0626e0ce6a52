"""Lens files as other programs write them, made of parts."""


def zmx(*surfaces: str, header: str = "", unit: str = "MM", aperture: str = "ENPD 10") -> str:
    """Return a file; each surface is its lines, separated by semicolons."""
    lines = ["MODE SEQ", f"UNIT {unit} X W", aperture, "WAVM 1 0.5875618 1", "PWAV 1", header]
    for number, surface in enumerate(surfaces):
        lines += [f"SURF {number}", *(f"  {line.strip()}" for line in surface.split(";"))]
    return "\n".join(lines)


FAR, IMAGE = "TYPE STANDARD; DISZ INFINITY", "TYPE STANDARD; DISZ 0"
FRONT = "STOP; TYPE STANDARD; CURV 0.02; DISZ 4; GLAS N-BK7 0 0 1.5 40 0 0 0; DIAM 12 1"
BACK = "TYPE STANDARD; CURV -0.01; DISZ 60; DIAM 12 1"
SINGLET = (FAR, FRONT, BACK, IMAGE)

# Aspheres, a cemented group, a tilt and decentres, as another program would write them. A tilt
# about one axis: two of them Optiland's reader puts together to 1e-7 only.
TILT = "TYPE COORDBRK; PARM 1 0.1; PARM 2 -0.2; PARM 3 0.4; DISZ 0"
FOREIGN = {
    "singlet": (FAR, FRONT, BACK, IMAGE),
    "conic": (FAR, FRONT.replace("CURV 0.02", "CURV 0.02; CONI -1.3"), BACK, IMAGE),
    "asphere": (
        FAR, FRONT.replace("STANDARD", "EVENASPH; PARM 2 1e-6; PARM 3 -2e-9"), BACK, IMAGE
    ),
    "cemented": (
        FAR, FRONT, "TYPE STANDARD; CURV -0.02; DISZ 2; GLAS N-SF11; DIAM 12 1", BACK, IMAGE
    ),
    "crystal": (FAR, FRONT.replace("N-BK7", "CAF2"), BACK, IMAGE),
    "near object": ("TYPE STANDARD; DISZ 300", FRONT, BACK, IMAGE),
    "two": (FAR, FRONT, BACK.replace("60", "5"), FRONT.replace("STOP; ", ""), BACK, IMAGE),
    "tilted": (
        FAR, "STOP; TYPE STANDARD; DISZ 0", TILT, FRONT.replace("STOP; ", ""),
        BACK.replace("DISZ 60", "DISZ -4"),
        "TYPE COORDBRK; PARM 3 -0.4; DISZ 0",
        "TYPE COORDBRK; PARM 1 -0.1; PARM 2 0.2; DISZ 64", IMAGE
    ),
}  # fmt: skip
