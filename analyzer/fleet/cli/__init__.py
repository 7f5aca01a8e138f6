"""The commands about lakes."""
