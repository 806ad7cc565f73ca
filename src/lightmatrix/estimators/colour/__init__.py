"""The estimate of a colour projector's T: one geometry for all channels and primaries.

Light of every colour takes the same ways through the scene. So one matrix G of a grey projector and
camera, rows of `camera pixels x projector pixels`, is the geometry of all nine pairs of a camera
channel a and a primary b, and each camera pixel c has nine gains, how much of b's light reaches a:

    T[(c, a), (q, b)] = M_c[a, b] G[c, q]

1. **Start.** Grey patterns show G by themselves. Without enough of them, a usual mixing of three
   filters separates the primaries well enough to find most of the geometry.
2. **Gains** (`mixing.py`). With G, each camera sample is a sum of three known amounts of light, one
   of each primary. Least squares give M_c, drawn to the mixing of the whole frame.
3. **Unmixing** (`unmixing.py`). The inverse of M_c turns the three channels of one photograph into
   what a grey camera would see under three grey patterns: those of red, green and blue. K colour
   photographs are then 3 K grey ones, and the coherent estimate finds G from them.

Steps 2 and 3 repeat. `estimate.py` holds the loop; `docs/colour.md` has measurements.
"""
