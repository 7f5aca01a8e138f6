"""The words and signs by which logs say who sent: the host, or the drive.

A log is taken to be written at the host's end: what it sent is a request, what it received a reply. A word for who
speaks ("slave TX") turns that round; a word for what was sent ("request") decides alone. The words are those of the
tools and libraries that people use; the misspelt one is real.
"""

from __future__ import annotations

from collections.abc import Iterable

from analyzer.catalogue import Role

_SENT, _RECEIVED = 1, -1

#: What was done, as seen by the one who speaks.
ACTIONS: dict[str, int] = {
    **dict.fromkeys(
        ("tx", "txd", "send", "sends", "sending", "sended", "sent", "transmit", "transmitted", "transmitting", "write",
         "writing", "wrote", "written", "发送", "发", "irp_mj_write", "送信", "gesendet", "sende", "senden", "envoyé", "envoi",
         "enviado", "enviando", "inviato", "trasmesso", "отправлено", "передача", "передано", "wysłano", "verzonden",
         "odesláno", "gönderilen", "gönderildi", "송신", "发出", "wr", "snd", "sendet", "émission", "envoyés", "envío",
         "enviados", "inviati", "trasmessi", "schreibe", "schreiben"),
        _SENT,
    ),
    **dict.fromkeys(
        ("rx", "rxd", "recv", "rcv", "rcvd", "recvd", "receive", "receives", "received", "receiving", "recieve", "recieved",
         "recieving", "read", "got", "接收", "收", "irp_mj_read", "受信", "empfangen", "empfang", "reçu", "recibido",
         "recibiendo", "ricevuto", "получено", "принято", "приём", "прием", "odebrano", "ontvangen", "přijato", "alınan",
         "alındı", "수신", "收到", "rd", "empfängt", "réception", "reçus", "recibidos", "ricevuti", "recebido", "recebidos",
         "empfange"),
        _RECEIVED,
    ),
    # Events of a serial port, as Node.js, Qt and .NET name them.
    **dict.fromkeys(("data event", "on data", "ondata", "readyread", "datareceived"), _RECEIVED),
}  # fmt: skip
#: Who speaks: the host is meant where none is named.
SPEAKERS: dict[str, int] = {
    **dict.fromkeys(("master", "host", "pc", "client", "上位机", "主机", "主站"), 1),
    **dict.fromkeys(("slave", "drive", "motor", "device", "servo", "server", "下位机", "从机", "从站", "电机", "驱动器"), -1),
}
#: Marks of traffic that was sent.
MATTERS: dict[str, int] = {
    **dict.fromkeys(("request", "req", "query", "poll", "command", "cmd", "anfrage", "befehl", "запрос",
                     "requête", "richiesta", "solicitud", "请求", "命令", "指令"), 1),
    **dict.fromkeys(
        ("response", "resp", "reply", "answer", "ack", "replies", "replied", "responds", "responded", "answers", "answered",
         "returns", "returned", "antwort", "回复", "应答", "返回", "响应", "ответ", "réponse", "risposta", "respuesta",
         "resposta"),
        -1,
    ),
}  # fmt: skip
#: Signs; they count only where no word stands beside them.
SIGNS: dict[str, int] = {
    **dict.fromkeys(("-->", "->", "=>", ">>>", ">>", ">", "→"), 1),
    **dict.fromkeys(("<--", "<-", "<=", "<<<", "<<", "<", "←"), -1),
}
#: Letters that mean an action only where they are all that is said.
LETTERS: dict[str, int] = {"t": _SENT, "r": _RECEIVED, "w": _SENT, "o": _SENT, "i": _RECEIVED, "out": _SENT, "in": _RECEIVED}

#: What stands between two names, of which the first speaks.
TO = " to "
#: Names of the two ends of a line, beside those of `SPEAKERS`, as programs print them: `PC=>MOT`, `TCP>COM`, `H>M`.
ENDS: dict[str, int] = {
    **SPEAKERS,
    **dict.fromkeys(("tcp", "net", "plc", "mcu", "esp", "arduino", "rpi", "controller", "app", "h"), 1),
    **dict.fromkeys(("mot", "drv", "dev", "com", "serial", "uart", "rs", "driver", "slv", "stepper", "bus", "s"), -1),
}

WORDS = frozenset((*ACTIONS, *SPEAKERS, *MATTERS))
_ROLES = {1: Role.REQUEST, -1: Role.REPLY, 0: Role.UNKNOWN}


def role_of(words: Iterable[str], sign: str = "") -> Role:
    """Return who sent what stands under these words and this sign, in lower case; `unknown` where they do not tell."""
    action = speaker = matter = 0
    for word in words:
        action = ACTIONS.get(word, action)
        # "Slave -> Master": the first speaks.
        speaker = speaker or SPEAKERS.get(word, 0)
        matter = MATTERS.get(word, matter)
    if not (action or speaker or matter):
        return _ROLES[SIGNS.get(sign, LETTERS.get(sign, 0))]
    return _ROLES[matter or (action or 1) * (speaker or 1)]


def speaker_of(sender: str, receiver: str) -> str:
    """Return `host` or `drive` for who speaks from one end of a line to the other; empty where the names do not tell.

    The names are in lower case; a number may stand behind them, as in `COM3`.
    """
    from_, to = (ENDS.get(name.rstrip("0123456789"), 0) for name in (sender, receiver))
    return {1: "host", -1: "drive", 0: ""}[0 if from_ == to else from_ or -to]


#: Who is spoken to.
OTHER_SIDE = {Role.REQUEST: Role.REPLY, Role.REPLY: Role.REQUEST, Role.UNKNOWN: Role.UNKNOWN}


def role_of_name(name: str) -> Role:
    """Return who sends on a line that is called so (`TX`, `uart rx`, `Host`), or as an arrow shows (`PC->`, `->PC`)."""
    words = "".join(c if c.isalnum() else " " for c in name.lower()).split()
    role = role_of(words)
    towards = name.strip().startswith(("->", "→")) or name.strip().endswith(("<-", "←"))
    if not towards or len(words) != 1 or words[0] not in SPEAKERS:
        return role
    return OTHER_SIDE[role]


class ReceivedMarks:
    """Holds back "received" until something was sent: a listener receives everything."""

    def __init__(self, sent: bool = False) -> None:
        self.sent = sent

    def __call__(self, role: Role) -> Role:
        """Return the role that a mark stands for."""
        if role is Role.REQUEST:
            self.sent = True
        return Role.UNKNOWN if role is Role.REPLY and not self.sent else role
