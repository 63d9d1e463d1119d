"""Parser of a page into elements with tags, attributes and texts."""

from dataclasses import dataclass, field
from html.parser import HTMLParser

VOID = {"meta", "link", "br", "hr", "img", "input", "col"}


@dataclass
class Element:
    """Element of a page: tag, attributes, text inside, tags of its ancestors."""

    tag: str
    attributes: dict[str, str]
    text: str = ""
    ancestors: list[str] = field(default_factory=list)


class Anatomy(HTMLParser):
    """All elements of a page in order; refuses tags that do not match."""

    def __init__(self, page: str) -> None:
        super().__init__(convert_charrefs=True)
        self.elements: list[Element] = []
        self._open: list[Element] = []
        self.feed(page)
        self.close()
        assert not self._open, f"never closed: {[e.tag for e in self._open]}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        names = [name for name, _ in attrs]
        assert len(set(names)) == len(names), f"<{tag}> repeats an attribute"
        element = Element(
            tag=tag,
            attributes={name: value or "" for name, value in attrs},
            ancestors=[e.tag for e in self._open],
        )
        self.elements.append(element)
        if tag not in VOID:
            self._open.append(element)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.handle_endtag(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open, f"</{tag}> closes nothing"
        assert self._open[-1].tag == tag, f"</{tag}> closes <{self._open[-1].tag}>"
        self._open.pop()

    def handle_data(self, data: str) -> None:
        for element in self._open:
            element.text += data

    def all(self, tag: str, of_class: str = "") -> list[Element]:
        """Return the elements with this tag, and this class if one is given."""
        return [
            e
            for e in self.elements
            if e.tag == tag and (not of_class or of_class in e.attributes.get("class", "").split())
        ]


def skeleton(page: str) -> list[str]:
    """Return the tag and the names of the attributes of every element."""
    return [f"{e.tag} {' '.join(e.attributes)}" for e in Anatomy(page).elements]
