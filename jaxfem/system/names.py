"""Names of the groups of rows that joints and contacts have."""


def joint_name(label: str) -> str:
    """Name of the rows of a group of joints."""
    return f"joint {label}"


def contact_name(label: str) -> str:
    """Name of the normal rows of a group of contacts."""
    return f"contact {label}"


def friction_name(label: str) -> str:
    """Name of the tangential rows of a group of contacts."""
    return f"contact {label} friction"
