"""Values in XML, changed in its text: comments, spaces and everything else stay as they are."""

from __future__ import annotations

from dataclasses import dataclass, field
from xml.parsers import expat

from stillcal.calib_core.errors import UserError


@dataclass(slots=True)
class Node:
    """An element and its place in bytes: start of its tag, inner to close its content; closed: <x/>."""

    tag: str
    attributes: dict[str, str]
    start: int
    inner: int
    closed: bool
    close: int = 0
    children: list[Node] = field(default_factory=list)
    parent: Node | None = None

    def child(self, tag: str) -> Node | None:
        """Return the first child of a name."""
        return next((c for c in self.children if c.tag == tag), None)

    def all(self, tag: str) -> list[Node]:
        """Return all elements of a name within this one, itself included."""
        own = [self] if self.tag == tag else []
        return own + [n for c in self.children for n in c.all(tag)]


def parsed(data: bytes) -> Node:
    """Return the root of an XML file. Raises UserError where it is not XML."""
    root = Node("", {}, 0, 0, False)
    open_nodes = [root]
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        at = parser.CurrentByteIndex
        inner = _tag_end(data, at)
        node = Node(tag, attributes, at, inner, data[inner - 2 : inner] == b"/>", parent=open_nodes[-1])
        open_nodes[-1].children.append(node)
        open_nodes.append(node)

    def end(tag: str) -> None:
        node = open_nodes.pop()
        node.close = node.inner if node.closed else parser.CurrentByteIndex

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise UserError(f"not XML: {error}") from error
    return root


def _tag_end(data: bytes, start: int) -> int:
    """Return the place behind the > that ends the tag at `start`; one within quotes does not."""
    quote = b""
    for i in range(start, len(data)):
        c = data[i : i + 1]
        if quote:
            quote = b"" if c == quote else quote
        elif c in (b"'", b'"'):
            quote = c
        elif c == b">":
            return i + 1
    raise UserError("not XML: a tag without end")


def text_at(data: bytes, node: Node) -> str:
    """Return the text of an element without children."""
    return data[node.inner : node.close].decode() if not node.closed else ""


def with_text(data: bytes, node: Node, text: str) -> bytes:
    """Return the file with another text in an element without children."""
    if node.closed:
        return _opened(data, node, text)
    return data[: node.inner] + text.encode() + data[node.close :]


def with_child(data: bytes, node: Node, tag: str, text: str = "", attributes: str = "") -> bytes:
    """Return the file with one more child at the end of an element, on a line of its own."""
    line = data[: node.start].rpartition(b"\n")[2]
    indent = line.decode() if not line.strip() else ""
    fresh = f"\n{indent}  <{tag}{attributes}>{text}</{tag}>"
    if node.closed:
        return _opened(data, node, f"{fresh}\n{indent}")
    content = data[node.inner : node.close]
    end = node.inner + len(content.rstrip())
    tail = (
        data[end:]
        if b"\n" in content[len(content.rstrip()) :]
        else f"\n{indent}".encode() + data[node.close :]
    )
    return data[:end] + fresh.encode() + tail


def _opened(data: bytes, node: Node, text: str) -> bytes:
    """Return the file with <tag/> as <tag>text</tag>."""
    head = data[: node.inner - 2].rstrip() + b">"
    return head + text.encode() + f"</{node.tag}>".encode() + data[node.inner :]
