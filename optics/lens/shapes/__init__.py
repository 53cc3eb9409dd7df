"""Kinds of surface, one file each: `registry` lists them, `base` says what each owes."""
