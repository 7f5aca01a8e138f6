"""From symptoms to causes: what is wrong on a bus, what shows it, and what to do next.

    pipeline -> Watch (a sink) -> Scene of each bus -> hypotheses -> ranking -> Diagnosis

The watch keeps what stands near trouble; clean traffic costs it next to nothing. A hypothesis has one subject: it looks at a
scene, and says which of its troubles it explains, how surely, and by what evidence. A new one is one file and one row in
`diagnose`; what its causes are called and mean stands in `causes`.
"""
