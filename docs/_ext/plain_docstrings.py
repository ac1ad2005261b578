"""This project's docstrings are plain text: paragraphs, `code` between backticks, and equations on lines that
are set in by four spaces. Here they become Markdown for generated pages, and reStructuredText for autodoc."""

from __future__ import annotations

import re
import unicodedata

from sphinx.application import Sphinx

INDENT = "    "
GREEK = {
    name: unicodedata.lookup(f"GREEK SMALL LETTER {name}")
    for name in ("alpha", "gamma", "mu", "phi", "pi", "rho", "sigma", "tau")
}
FUNCTIONS = ("cos", "det", "exp", "log", "max", "min")
OPERATORS = ("KL", "cov", "tr")
_PIECE = re.compile(r"(`[^`]*`)")
_FIELD = re.compile(r"(Raises [A-Z]|[a-z_]+(, [a-z_]+)*( \([^)]*\))?: )")


def paragraphs(doc: str) -> list[str]:
    return [part for part in re.split(r"\n\s*\n", doc.strip("\n")) if part.strip()]


def is_equation(paragraph: str) -> bool:
    return all(line.startswith(INDENT) for line in paragraph.splitlines())


def markdown(doc: str) -> str:
    """Return a whole docstring with typeset equations."""
    parts = []
    for paragraph in paragraphs(doc):
        if is_equation(paragraph):
            parts += [f"$$\n{latex(line.strip())}\n$$" for line in paragraph.splitlines()]
        else:
            parts.append(inline(paragraph))
    return "\n\n".join(parts)


def bullets(paragraph: str) -> str:
    """Each clause of a paragraph, which ends in a semicolon or as a sentence does, as one of a list."""
    text, parts, start, depth = " ".join(paragraph.split()), [], 0, 0
    for i, c in enumerate(text):
        depth += (c == "(") - (c == ")")
        ends = c == ";" or (c == "." and not text[:i].endswith((" al", " eq", "e.g", "i.e")))
        if ends and depth == 0 and text[i + 1 : i + 2] in ("", " "):
            parts.append(text[start:i].strip())
            start = i + 1
    return "\n".join(f"- {inline(_capital(part))}." for part in parts)


def _capital(text: str) -> str:
    """Symbols, and names of code, stay as they are."""
    return text if re.match(r"\W|(?!a )\w\b|pi[*_]", text) else text[:1].upper() + text[1:]


def inline(text: str) -> str:
    """Markdown of running text, in one line."""
    pieces = _PIECE.split(" ".join(text.split()))
    return "".join(p if p.startswith("`") else _escaped(p) for p in pieces)


def _escaped(text: str) -> str:
    """Symbols by their letters; and nothing in it is markup."""
    text = re.sub(r"(?<![\w-])[a-z]+(?![a-z-])", lambda match: GREEK.get(match[0], match[0]), text)
    text = text.replace("^T", "ᵀ").replace("^2", "²")
    return re.sub(r"([\\*_<>\[\]$|#~])", r"\\\1", text)


def latex(line: str) -> str:
    """Return TeX for an equation as docstrings write it: names of Greek letters, R* and `x^T`, words
    between symbols, and its number behind five spaces."""
    line, _, number = line.partition("     ")
    line = re.sub(r"(?<![\w(])E(?=_|\[| )", r"\\mathbb{E}", line)
    line = re.sub(r"_\(([^()]*)\)", r"_{\1}", line)
    line = (
        re.sub(r"\*", "^*", line).replace("||", r"\,\|\,").replace("<=", r"\le ").replace(" ~ ", r" \propto ")
    )
    line = re.sub(r"\^T\b", r"^\\top", line)
    line = re.sub(r"(?<![\\a-zA-Z])[a-zA-Z]{2,}", _word, line.replace("   ", r" \qquad "))
    return line + (rf" \qquad \text{{{number.strip()}}}" if number.strip() else "")


def _word(match: re.Match[str]) -> str:
    word = match[0]
    if word in (*GREEK, *FUNCTIONS, "sum"):
        return f"\\{word} "
    if word == "grad":
        return r"\nabla "
    if word in OPERATORS:
        return rf"\operatorname{{{word}}}"
    beside = match.string[max(match.start() - 1, 0)] + match.string[match.end() : match.end() + 1]
    return rf"\mathrm{{{word}}}" if set(beside) & set("()^") else rf"\text{{ {word} }}"


def to_rst(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Lists what each line says of a parameter apart; nothing in a docstring is markup but backticks."""
    found: list[str] = []
    for paragraph in paragraphs("\n".join(lines)):
        if is_equation(paragraph):
            found += ["::", "", *(INDENT + line for line in paragraph.splitlines()), ""]
            continue
        for line in paragraph.splitlines():
            if found and found[-1] and _FIELD.match(line):
                found.append("")
            pieces = _PIECE.split(line)
            found.append(
                "".join(f"`{p}`" if p.startswith("`") else re.sub(r"([\\*_|`])", r"\\\1", p) for p in pieces)
            )
        found.append("")
    lines[:] = found


def short_types(
    app: Sphinx,
    what: str,
    name: str,
    obj: object,
    options: object,
    arguments: str | None,
    returned: str | None,
) -> tuple[str | None, str | None]:
    """Arrays of 64-bit floats by the name that they have in the code."""

    def short(text: str | None) -> str | None:
        long = r"TypeAliasForwardRef\('(\w+)'\)"
        return text and re.sub(long, r"\1", text).replace("ndarray[tuple[Any, ...], dtype[float64]]", "Array")

    return short(arguments), short(returned)


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("autodoc-process-docstring", to_rst)
    app.connect("autodoc-process-signature", short_types)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
