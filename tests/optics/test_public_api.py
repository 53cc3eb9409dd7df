"""The package's own names."""

import optics


def test_every_public_name_loads_and_is_listed():
    for name in optics.__all__:
        assert getattr(optics, name) is not None
        assert name in dir(optics)


def test_names_are_not_hidden_by_modules_of_the_same_name():
    import optics.figures
    import optics.rays.spots

    modules = {name for name in vars(optics) if getattr(getattr(optics, name), "__name__", "").startswith("optics.")}
    assert not modules & set(optics.__all__)
