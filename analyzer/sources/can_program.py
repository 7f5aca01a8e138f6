"""CAN frames that a program sends, over several of its lines: put together, one line for each.

    byte stop[3] = {0xF7, 0x02, 0xFA};  CAN.sendMsgBuf(0x01, 0, 3, stop);            Arduino: identifier, extended, length, data
    const uint8_t ON[8] = {0x88};  msg.id = 0x141;  memcpy(msg.buf, ON, 8);          a message field by field
    byte b[8];  b[0] = 0x94;  b[1] = 0x00;  CAN.sendMsgBuf(0x01, 0, 2, b);          an array, element by element
    CAN.beginPacket(0x01);  CAN.write(0x30);  CAN.write(0x31);  CAN.endPacket();     byte by byte
    canMsg.can_id = 0x01;  canMsg.can_dlc = 2;  canMsg.data[0] = 0x31;  ...          the fields of SocketCAN's struct

What comes out is a call as programs of python-can have it, which `can_text` reads. Other lines stay as they are. A call whose
identifier or data are known at run time only is passed over.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

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
    rf"|(?:data|buf|Data)\[(?P<at>{_N})\]|(?P<flag>extended|ext|flags\.extended|extd))\s*=\s*(?P<value>\w+)"
)
_COPY = re.compile(r"\bmemcpy\(\s*&?(?P<message>\w+)(?:\.|->)(?:data|buf|Data)\s*,\s*&?(?P<data>\w+)")
_BEGIN = re.compile(r"\bbegin(?P<extended>Extended)?Packet\(\s*(?P<id>\w+)")
_WRITE = re.compile(r"\b\w+(?:\.|->)write\(\s*(?:\([^()]*\)\s*)?(?P<value>[^;]*?)\s*\)\s*(?:;|$)")
#: One element of an array, which may be declared without its bytes.
_ELEMENT = re.compile(rf"(?<![\w.>])(?P<name>\w+)\[\s*(?P<at>{_N})\s*\]\s*=\s*(?P<value>[^;={{]+);")
_END = re.compile(r"\bendPacket\(")
_OUT = re.compile(r"\b(?:send\w*|write|transmit\w*|twai_transmit|tryToSend|HAL_CAN_\w+)\(\s*[^()]*?&?(?P<message>\w+)\s*[,)]")
#: STM32: a header with the fields, and the data apart from it.
_HAL = re.compile(r"\bHAL_\w*CAN_Add\w+\(\s*&?\w+\s*,\s*&?(?P<message>\w+)\s*,\s*&?(?P<data>\w+)")
_COMMENT = re.compile(r"^\s*(?://|\*|/\*)|//.*$")
_TRUE = ("1", "true", "CAN_EXTID", "CAN_EFF", "EXT")
_BYTES, _NAMES, _LARGEST = 8, 500, 0xFF


class Program:
    """Follows the lines of a program. Call it with each line: it returns the frames that the line sends.

    `parts`: lines that fill an array or a packet, of those that were sent.
    """

    def __init__(self) -> None:
        self._arrays: dict[str, list[int]] = {}
        self._numbers: dict[str, int] = {}
        self._fields: dict[str, dict[str, int]] = {}
        self._packet: list[int] | None = None
        self._packet_id = 0
        self._wide = False
        self._filled_lines = self.parts = 0

    def __call__(self, line: str) -> Iterator[str]:
        """Yield a call for each frame that a line sends."""
        if not any(sign in line for sign in ";{#") or len(self._arrays) + len(self._numbers) > _NAMES:
            return
        text = _COMMENT.sub("", line)
        for array in _ARRAY.finditer(text):
            values = [_number(token) for token in array["list"].split(",")]
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
            if call["data"] in self._arrays and self._value(call["id"]) is not None:
                yield from self._frame(call["id"], call["data"], call["length"] or "", False)
                return
        for call in _HAL.finditer(text):
            fields, data = self._fields.get(call["message"], {}), self._arrays.get(call["data"], [])
            if "id" in fields:
                yield from _call(fields["id"], data[: fields.get("length", len(data))], bool(fields.get("extended")))
            return
        for out in _OUT.finditer(text):
            fields = self._fields.get(out["message"], {})
            if "id" in fields:
                data = [fields.get(str(at), 0) for at in range(fields.get("length", self._filled(fields)))]
                yield from _call(fields["id"], data, bool(fields.get("extended")))

    def _written(self, text: str) -> Iterator[str]:
        """Yield what is written byte by byte between the begin and the end of a packet."""
        begin = _BEGIN.search(text)
        if begin is not None and (number := self._value(begin["id"])) is not None:
            self._packet, self._packet_id, self._wide = [], number, begin["extended"] is not None
        for each in _WRITE.finditer(text):
            value = self._value(each["value"])
            # What is known at run time only makes the whole packet so.
            self._packet = None if value is None or self._packet is None else [*self._packet, value]
        if self._packet is not None and _END.search(text) is not None:
            yield from _call(self._packet_id, self._packet, self._wide)
            self._packet = None

    def _put(self, element: re.Match[str]) -> None:
        name, at, value = element["name"], _number(element["at"]), self._value(element["value"].strip())
        if value is None or at >= _BYTES:
            self._arrays.pop(name, None)
            return
        data = self._arrays.setdefault(name, [])
        data += [0] * (at + 1 - len(data))
        data[at] = value

    def _set(self, field: re.Match[str]) -> None:
        value = self._value(field["value"])
        if value is None and field["flag"] is None:
            return
        own = self._fields.setdefault(field["message"], {})
        if field["at"] is not None:
            own[str(_number(field["at"]))] = value or 0
        elif field["flag"] is not None:
            own["extended"] = int(field["value"] in _TRUE)
        else:
            own["id" if "id" in field["field"].lower() else "length"] = value or 0
            if field["field"] == "ExtId":
                own["extended"] = 1

    @staticmethod
    def _filled(fields: dict[str, int]) -> int:
        return 1 + max((int(name) for name in fields if name.isdecimal()), default=-1)

    def _frame(self, identifier: str, name: str, length: str, extended: bool) -> Iterator[str]:
        number, data = self._value(identifier), self._arrays.get(name)
        if number is None or data is None:
            return
        size = self._value(length)
        yield from _call(number, data if size is None or size > len(data) else data[:size], extended)

    def _value(self, text: str) -> int | None:
        return _number(text) if re.fullmatch(_N, text or "") else self._numbers.get(text)


def _call(identifier: int, data: list[int], extended: bool) -> Iterator[str]:
    """Yield a frame as `can_text` reads it: python-can takes 29 bits where nothing else is said."""
    if data and len(data) <= _BYTES and max(data) <= _LARGEST:
        listed = ", ".join(f"0x{value:02X}" for value in data)
        yield f"{'can.' * extended}Message(arbitration_id=0x{identifier:X}, data=[{listed}])"


def _number(text: str) -> int:
    text = text.strip()
    return int(text, 16) if text[:2].lower() == "0x" else int(text)
