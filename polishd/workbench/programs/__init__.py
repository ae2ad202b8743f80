"""Part programs: shown, retimed, verified, made."""
