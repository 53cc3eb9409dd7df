"""The cube-mirror bench as a Mitsuba scene (CUBE09)."""
