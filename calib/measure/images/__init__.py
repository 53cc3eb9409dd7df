"""Images as input: frames, arrays, files of other programs; steps and saturation of their converters."""
