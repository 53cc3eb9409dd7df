"""Terms are explained where a page first uses them, and nowhere else."""

from experiments.harness.glossary import Glossary, Term

TERMS = {"TE": Term("temporal error"), "LSFE": Term("low <spatial>", "https://example.org"), "PSF": Term("an image")}


def test_the_first_use_is_marked_and_listed_the_second_is_not():
    glossary = Glossary(TERMS)
    lead, body = glossary.mark("<p>TE and LSFE-C1.</p>"), glossary.mark("<p>TE again, LSFE.</p>")
    assert lead.count('href="#term-TE"') == 1
    assert 'title="low &lt;spatial&gt;"' in lead
    assert "LSFE</abbr></a>-C1" in lead
    assert body == "<p>TE again, LSFE.</p>"
    assert list(glossary.used) == ["TE", "LSFE"]


def test_words_within_words_code_headings_links_and_attributes_stay():
    glossary = Glossary(TERMS)
    text = '<h2>TE</h2><code>TE</code><a href="x">TE</a><img alt="TE"><p>STEP, ePSF, TE_x, NOTE</p>'
    assert glossary.mark(text) == text
    assert not glossary.used
    assert "abbr" in glossary.mark("<p>(TE)</p>")
