"""candump's log form, as `candump -L` prints it and canplayer, SavvyCAN and python-can read it.

    (1436509052.249713) can0 001#F60140023A          T at the end: the host sent the frame
    (1436509052.249713) can0 12345678##0AABB         extended identifier; CAN FD, whose flags no source keeps
    (1436509052.249713) can0 123#R                   remote request; its length is not known
    (1436509052.249713) can0 20000004#0004...        error frame with its class

Times are cut to microseconds unless nine digits are asked for: canplayer of most distributions reads more than six
digits as a larger number. Only the host is marked, since a listener receives everything.
"""

from __future__ import annotations

from analyzer.catalogue import Role
from analyzer.export import Writer
from analyzer.records import CanFrame, Chunk
from analyzer.values import CAN_ID_LIMIT, SECOND_NS

_ERROR_FLAG = 0x2000_0000


class CandumpWriter(Writer):
    """Writes a line for each CAN frame."""

    def traffic(self, item: Chunk | CanFrame) -> None:
        assert isinstance(item, CanFrame)  # the table of formats says what is held
        assert item.t_ns is not None  # the export makes times up where there are none
        seconds, rest = divmod(item.t_ns, SECOND_NS)
        if item.error:
            ident = f"{item.id | _ERROR_FLAG:08X}"
        else:
            ident = f"{item.id:08X}" if item.extended or item.id > CAN_ID_LIMIT else f"{item.id:03X}"
        mark = "#R" if item.remote else f"##0{item.data.hex().upper()}" if item.fd else f"#{item.data.hex().upper()}"
        sent = " T" if item.direction is Role.REQUEST else ""
        fraction = f"{rest:09d}"[: self.choices.digits]
        self.stream.write(f"({seconds}.{fraction}) {item.port} {ident}{mark}{sent}\n".encode())
