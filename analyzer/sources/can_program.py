"""CAN frames that a program sends, over several of its lines: put together, one line for each.

    byte stop[3] = {0xF7, 0x02, 0xFA};  CAN.sendMsgBuf(0x01, 0, 3, stop);            Arduino: identifier, extended, length, data
    const uint8_t ON[8] = {0x88};  msg.id = 0x141;  memcpy(msg.buf, ON, 8);          a message field by field
    byte b[8];  b[0] = 0x94;  b[1] = 0x00;  CAN.sendMsgBuf(0x01, 0, 2, b);          an array, element by element
    CAN.beginPacket(0x01);  CAN.write(0x30);  CAN.write(0x31);  CAN.endPacket();     byte by byte
    canMsg.can_id = 0x01;  canMsg.can_dlc = 2;  canMsg.data[0] = 0x31;  ...          the fields of SocketCAN's struct

    can.Message(arbitration_id=0x140 + node, data=[0xA2, 0, 0, 0, low, high, 0, 0])  a call whose numbers are computed

What comes out is a call as programs of python-can have it, which `can_text` reads. Other lines stay as they are.

Sums, shifts and masks of known numbers are computed. What is known at run time only is passed over, but for two things. In a
frame whose last byte is known it counts as 0, because then no check follows from it. A base with a node added is the first
node. An identifier that only has a name follows from the sum at the end of the data.
"""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Callable, Iterator, Sequence

_N = r"(?:0[xX][0-9A-Fa-f]+|\d+)"
_LIST = rf"\{{\s*(?P<list>{_N}(?:\s*,\s*{_N})*)\s*,?\s*\}}"
_ARRAY = re.compile(rf"\b(?P<name>\w+)\s*\[\s*(?P<size>{_N})?\s*\]\s*=\s*{_LIST}")
_CONSTANT = re.compile(
    rf"(?:#define\s+(?P<defined>\w+)\s+\(?|\b(?:const\w*|static|u?int\w*|long|byte|unsigned|uint32_t)\s[\w\s]*?(?P<name>\w+)\s*=\s*)(?P<value>{_N})\b"
)
#: Calls that send: an identifier, whether it has 29 bits, perhaps a remote flag, a length, and the data.
_SEND_BUFFER = re.compile(
    r"\bsendMsgBuf\(\s*(?P<id>\w+)\s*,\s*(?P<extended>\w+)\s*(?:,\s*\w+\s*)??,\s*(?P<length>[\w()]+)\s*,\s*(?:\([^()]*\)\s*)?&?(?P<data>\w+)"
)
_SEND = re.compile(
    rf"\b\w*(?:[sS]end|[tT]ransmit|[wW]rite)\w*\(\s*(?P<id>\w+)\s*,\s*(?:(?P<length>{_N})\s*,\s*)?(?P<data>[A-Za-z_]\w*)\s*(?:,\s*[\w()]+\s*)?\)"
)
_FIELD = re.compile(
    rf"\b(?P<message>\w+)(?:\.|->)(?:(?P<field>can_id|id|identifier|StdId|ExtId|can_dlc|len|length|dlc|DLC|data_length_code)"
    rf"|(?:data|buf|Data)\[(?P<at>{_N})\]|(?P<flag>extended|ext|flags\.extended|extd))\s*=(?!=)\s*(?P<value>[^;={{]+?)\s*(?:;|$)"
)
_COPY = re.compile(r"\bmemcpy\(\s*&?(?P<message>\w+)(?:\.|->)(?:data|buf|Data)\s*,\s*&?(?P<data>\w+)")
_BEGIN = re.compile(r"\bbegin(?P<extended>Extended)?Packet\(\s*(?P<id>\w+)")
_WRITE = re.compile(r"\b\w+(?:\.|->)write\(\s*(?:\([^()]*\)\s*)?(?P<value>[^;]*?)\s*\)\s*(?:;|$)")
#: One element of an array, which may be declared without its bytes.
_ELEMENT = re.compile(rf"(?<![\w.>])(?P<name>\w+)\[\s*(?P<at>{_N})\s*\]\s*=\s*(?P<value>[^;={{]+);")
_END = re.compile(r"\bendPacket\(")
_OUT = re.compile(r"\b(?:send\w*|write|transmit\w*|twai_transmit|tryToSend|HAL_CAN_\w+)\((?P<given>[^()]*)")
#: STM32: a header with the fields, and the data apart from it.
_HAL = re.compile(r"\bHAL_\w*CAN_Add\w+\(\s*&?\w+\s*,\s*&?(?P<message>\w+)\s*,\s*&?(?P<data>\w+)")
_NAME = re.compile(r"[A-Za-z_]\w*")
_COMMENT = re.compile(r"^\s*(?://|\*|/\*)|//.*$")
_TRUE = ("1", "true", "CAN_EXTID", "CAN_EFF", "EXT")
_BYTES, _NAMES, _LARGEST = 8, 500, 0xFF
#: A call of python-can with its numbers as they stand in the program.
_MESSAGE = re.compile(
    r"\bMessage\((?=.*?\barbitration_id\s*=\s*(?P<id>[^,()]+))(?=.*?\bdata\s*=\s*(?:bytes|bytearray)?\(?\s*\[(?P<list>[^\[\]]*)\])"
)
_CASTS = re.compile(r"\((?:const |unsigned |u?int(?:8|16|32)_t|byte|char|int|long)+\)|\b(?:byte|u?int8_t|int)(?=\()")
_ARITHMETIC = re.compile(r"[\w\s()+*/%&|^~<>-]{1,60}")
_OPERATORS: dict[type[ast.operator], Callable[[int, int], int]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.LShift: operator.lshift,
    ast.RShift: operator.rshift, ast.BitAnd: operator.and_, ast.BitOr: operator.or_, ast.BitXor: operator.xor,
}  # fmt: skip
_SHIFTS, _WIDEST = (ast.LShift, ast.RShift), 32
#: Nodes whose number a sum can tell, and the least code that their drives have.
_NODES, _LEAST_CODE = range(17), 0x30


class Program:
    """Follows the lines of a program. Call it with each line: it returns the frames that the line sends.

    `parts`: lines that fill an array or a packet, of those that were sent.
    """

    def __init__(self) -> None:
        self._arrays: dict[str, list[int | None]] = {}
        self._numbers: dict[str, int] = {}
        self._fields: dict[str, dict[str, int | None]] = {}
        self._packet: list[int | None] | None = None
        self._packet_id: int | None = None
        self._wide = False
        self._filled_lines = self.parts = 0

    def __call__(self, line: str) -> Iterator[str]:
        """Yield a call for each frame that a line sends."""
        if not any(sign in line for sign in ";{#") or len(self._arrays) + len(self._numbers) > _NAMES:
            return
        text = _COMMENT.sub("", line)
        for array in _ARRAY.finditer(text):
            values: list[int | None] = [_number(token) for token in array["list"].split(",")]
            size = _number(array["size"]) if array["size"] else len(values)
            self._arrays[array["name"]] = values + [0] * (min(size, _BYTES) - len(values))
        elements = list(_ELEMENT.finditer(text))
        for element in elements:
            self._put(element)
        self._filled_lines += bool(elements) or (self._packet is not None and _WRITE.search(text) is not None)
        for constant in _CONSTANT.finditer(text):
            self._numbers[constant["defined"] or constant["name"]] = _number(constant["value"])
        for field in _FIELD.finditer(text):
            self._set(field)
        for copy in _COPY.finditer(text):
            for at, value in enumerate(self._arrays.get(copy["data"], ())):
                self._fields.setdefault(copy["message"], {})[str(at)] = value
        for sent in (*self._calls(text), *self._written(text)):
            self.parts, self._filled_lines = self.parts + self._filled_lines, 0
            yield sent

    def _calls(self, text: str) -> Iterator[str]:
        for call in _SEND_BUFFER.finditer(text):
            yield from self._frame(call["id"], call["data"], call["length"], call["extended"] in _TRUE)
            return
        for call in _SEND.finditer(text):
            if call["data"] in self._arrays:
                yield from self._frame(call["id"], call["data"], call["length"] or "", False)
                return
        for call in _HAL.finditer(text):
            fields, data = self._fields.get(call["message"], {}), self._arrays.get(call["data"], [])
            if "id" in fields:
                size = fields.get("length") or len(data)
                yield from _call(fields["id"], data[:size], bool(fields.get("extended")))
            return
        for out in _OUT.finditer(text):
            fields = next((own for name in _NAME.findall(out["given"]) if "id" in (own := self._fields.get(name, {}))), {})
            if "id" in fields:
                data = [fields.get(str(at), 0) for at in range(min(_BYTES, fields.get("length") or self._filled(fields)))]
                yield from _call(fields["id"], data, bool(fields.get("extended")))

    def _written(self, text: str) -> Iterator[str]:
        """Yield what is written byte by byte between the begin and the end of a packet."""
        begin = _BEGIN.search(text)
        if begin is not None:
            self._packet, self._packet_id, self._wide = [], self._value(begin["id"]), begin["extended"] is not None
        for each in _WRITE.finditer(text):
            if self._packet is not None:
                self._packet.append(self._value(each["value"]))
        if self._packet is not None and _END.search(text) is not None:
            yield from _call(self._packet_id, self._packet, self._wide)
            self._packet = None

    def _put(self, element: re.Match[str]) -> None:
        name, at, value = element["name"], _number(element["at"]), self._value(element["value"].strip())
        if at >= _BYTES:
            self._arrays.pop(name, None)
            return
        data = self._arrays.setdefault(name, [])
        data += [0] * (at + 1 - len(data))
        data[at] = value

    def _set(self, field: re.Match[str]) -> None:
        value = self._value(field["value"])
        own = self._fields.setdefault(field["message"], {})
        if field["at"] is not None:
            own[str(_number(field["at"]))] = value
        elif field["flag"] is not None:
            own["extended"] = int(field["value"] in _TRUE)
        else:
            own["id" if "id" in field["field"].lower() else "length"] = value
            if field["field"] == "ExtId":
                own["extended"] = 1

    @staticmethod
    def _filled(fields: dict[str, int | None]) -> int:
        return 1 + max((int(name) for name in fields if name.isdecimal()), default=-1)

    def _frame(self, identifier: str, name: str, length: str, extended: bool) -> Iterator[str]:
        number, data = self._value(identifier), self._arrays.get(name)
        if data is None:
            return
        size = self._value(length)
        yield from _call(number, data if size is None or size > len(data) else data[:size], extended)

    def resolved(self, line: str) -> str:
        """Return a line with a call of python-can whose numbers are computed, as far as they are known."""
        call = _MESSAGE.search(line)
        items = [item.strip() for item in call["list"].split(",") if item.strip()] if call is not None else []
        if call is None or not items or all(re.fullmatch(_N, token) for token in (call["id"].strip(), *items)):
            return line
        identifier = self._value(call["id"]) if "+" not in call["id"] else self._node(call["id"])
        extended = re.search(r"extended_id\s*=\s*False", line) is None
        return next(_call(identifier, [self._value(item) for item in items], extended), line)

    def _node(self, text: str) -> int | None:
        """Return an identifier that is a base with a number added: of the first node, where that is not known."""
        parts = [self._value(part) for part in text.split("+")]
        known = sum(part for part in parts if part is not None)
        return None if not known else known + (None in parts)

    def _value(self, text: str) -> int | None:
        """Return the number that an expression has, None where it is known at run time only."""
        text = _CASTS.sub("", text or "").strip()
        if re.fullmatch(_N, text):
            return _number(text)
        if text in self._numbers or _ARITHMETIC.fullmatch(text) is None:
            return self._numbers.get(text)
        try:
            return self._computed(ast.parse(text, mode="eval").body)
        except (SyntaxError, ValueError, RecursionError):
            return None

    def _computed(self, node: ast.expr) -> int | None:
        if isinstance(node, ast.Constant) and type(node.value) is int:
            return node.value
        if isinstance(node, ast.Name):
            return self._numbers.get(node.id)
        if not isinstance(node, ast.BinOp) or type(node.op) not in _OPERATORS:
            return None
        one, other = self._computed(node.left), self._computed(node.right)
        wide = isinstance(node.op, _SHIFTS) and (other is None or not 0 <= other < _WIDEST)
        return None if one is None or other is None or wide else _OPERATORS[type(node.op)](one, other)


def _call(identifier: int | None, data: Sequence[int | None], extended: bool) -> Iterator[str]:
    """Yield a frame as `can_text` reads it: python-can takes 29 bits where nothing else is said."""
    if not data or len(data) > _BYTES or data[0] is None or data[-1] is None:
        return
    values = [value or 0 for value in data]
    if max(values) > _LARGEST or min(values) < 0:
        return
    if identifier is None and None not in data and len(data) > 1 and data[0] >= _LEAST_CODE:
        node = (values[-1] - sum(values[:-1])) & _LARGEST
        identifier = (node or 1) if node in _NODES else None
    if identifier is not None:
        listed = ", ".join(f"0x{value:02X}" for value in values)
        yield f"{'can.' * extended}Message(arbitration_id=0x{identifier:X}, data=[{listed}])"


def _number(text: str) -> int:
    text = text.strip()
    return int(text, 16) if text[:2].lower() == "0x" else int(text)
