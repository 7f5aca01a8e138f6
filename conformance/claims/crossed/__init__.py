"""Claims about motions in which any two conditions meet."""
