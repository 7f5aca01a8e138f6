"""The model of a drive: what it should be after any sequence of requests, and how sequences are drawn.

A walk tests a drive against its twin: an emulated drive that does what the manual says (`twin`). Both are sent the same bytes,
step by step (`steps`), and each reply of the drive is compared with that of the twin (`pair`). What is discrete must be the
same; places and speeds may differ by what was measured of the line and of the resting shaft (`comparing`). What the drive says
by itself at the end of a motion is compared when it stands (`unasked`, `settling`). A motion is looked at on its way, too, and
other reads while a setting has to wait (`looks`). A request goes to the drive, to all, to its group or in a package; between
requests come frames that are for another drive or for none (`asides`). Where the manual leaves open what becomes of the shaft,
the twin takes over what the drive tells (`adopting`). A `walk` does one step after the other, so that the whole history counts.
Its `route` lets any two `conditions` meet, in an order and with `values` drawn by a seed. `corners` are short walks, always the
same, to where a route seldom comes. If a drive is refuted, its `story` is shortened to the fewest steps that show it.

Beside walks stand what claims and tests draw from: covering arrays (`covering`), limits of fields (`limits`), strategies of
Hypothesis (`strategies`) and the parameters of LK drives (`lk_parameters`).
"""
