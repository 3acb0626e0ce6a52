"""Compiled loops: pixels between nodes, and sums over all pixels that tell what the nodes see."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[Any]


@njit(cache=True, nogil=True, error_model="numpy")
def between_nodes(place: Array, nodes: Array, first: Array, shares: Array) -> None:
    """Fill in the shares [n 4] of four nodes [g] in each place [n], by cubic interpolation.

    `first` is the node after the place before, the first of the four afterwards.
    """
    last = nodes.size - 4
    for i in range(place.size):
        k = min(max(first[i] - 2, 0), last)
        first[i] = k
        a, b, c, d = place[i] - nodes[k : k + 4]
        ab, ac, ad = b - a, c - a, d - a
        bc, bd, cd = c - b, d - b, d - c
        shares[i, 0] = b * c * d / (ab * ac * ad)
        shares[i, 1] = -a * c * d / (ab * bc * bd)
        shares[i, 2] = a * b * d / (ac * bc * cd)
        shares[i, 3] = -a * b * c / (ad * bd * cd)


@njit(cache=True, nogil=True, error_model="numpy")
def interpolated(first: Array, shares: Array, values: Array, out: Array) -> None:
    """Fill `out` [n] with values [g] at the nodes, interpolated; see `between_nodes`."""
    for i in range(first.size):
        k = first[i]
        out[i] = (
            shares[i, 0] * values[k]
            + shares[i, 1] * values[k + 1]
            + shares[i, 2] * values[k + 2]
            + shares[i, 3] * values[k + 3]
        )


@njit(cache=True, nogil=True, error_model="numpy")
def node_products(
    pointers: Array,
    taps: Array,
    weights: Array,
    first: Array,
    shares: Array,
    powers: Array,
    right: Array,
    products: Array,
    with_right: Array,
) -> None:
    """Add up, over whitened pixels, products of what the nodes are to each of them.

        products[k, l] = sum W_k^T A^T A W_l,   with_right[k] = sum W_k^T A^T R

    with the whitener A [m n] in compressed rows and the interpolation W_k from the nodes, times the
    factor k of a pixel in `powers` [n k]; products [k k g g] and with_right [k g q] are zero
    before.
    """
    kinds, nodes, columns = with_right.shape
    row = np.zeros((kinds, nodes))
    for r in range(right.shape[0]):
        start, stop = nodes, 0
        for t in range(pointers[r], pointers[r + 1]):
            i = taps[t]
            at = first[i]
            start, stop = min(start, at), max(stop, at + 4)
            for k in range(kinds):
                weight = weights[t] * powers[i, k]
                for s in range(4):
                    row[k, at + s] += weight * shares[i, s]
        for k in range(kinds):
            for a in range(start, stop):
                own = row[k, a]
                if own == 0.0:
                    continue
                for other in range(k):
                    for b in range(start, stop):
                        products[k, other, a, b] += own * row[other, b]
                for b in range(start, a + 1):
                    products[k, k, a, b] += own * row[k, b]
                for q in range(columns):
                    with_right[k, a, q] += own * right[r, q]
        row[:, start:stop] = 0.0
    for k in range(kinds):
        for a in range(nodes):
            for b in range(a):
                products[k, k, b, a] = products[k, k, a, b]
        for other in range(k):
            products[other, k] = products[k, other].T


@njit(cache=True, nogil=True, error_model="numpy")
def node_reach(products: Array, reach: Array) -> None:
    """Fill in [g 2]: the first node and the last but one that share pixels with each."""
    nodes = products.shape[2]
    for a in range(nodes):
        reach[a] = a, a + 1
        for b in range(nodes):
            if products[0, 0, a, b] != 0.0:
                reach[a, 0], reach[a, 1] = min(reach[a, 0], b), max(reach[a, 1], b + 1)


@njit(cache=True, nogil=True, error_model="numpy")
def times_nodes(products: Array, reach: Array, right: Array, out: Array) -> None:
    """Fill `out` [g q] with products [g g] times `right` [g q]; see `node_reach`."""
    for a in range(products.shape[0]):
        own = out[a]
        own[:] = 0.0
        for b in range(reach[a, 0], reach[a, 1]):
            share, other = products[a, b], right[b]
            for q in range(own.size):
                own[q] += share * other[q]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def across_nodes(products: Array, reach: Array, power: Array, seen: Array, out: Array) -> None:
    """Fill in [k s g] what pixels see of columns [s g], each of a power, times all their factors.

    out[k, m] = products[k, power_m] seen[m]
    """
    for k in range(products.shape[0]):
        for a in range(seen.shape[1]):
            for m in range(seen.shape[0]):
                other, total = power[m], 0.0
                for b in range(reach[a, 0], reach[a, 1]):
                    total += products[k, other, a, b] * seen[m, b]
                out[k, m, a] = total
