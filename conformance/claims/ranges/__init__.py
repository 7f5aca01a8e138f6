"""Claims about ranges: values at, inside and outside the limits of each field."""
