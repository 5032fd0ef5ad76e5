import io

from rich.console import Console

from pipeline.terminal import say


def test_a_sentence_is_printed_as_it_stands() -> None:
    out = io.StringIO()
    sentence = "results: /a/path/[bold]that/is/longer/than/the/console and 12 more words"
    say(Console(file=out, width=20, force_terminal=True), sentence)
    assert out.getvalue() == sentence + "\n"
