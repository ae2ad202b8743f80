"""KUKA controllers: programs by a share, variables and commands by C3 Bridge (docs/protocols/kuka_kvp.md)."""
