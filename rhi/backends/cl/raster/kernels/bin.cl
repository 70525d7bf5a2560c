// Binning: lists of the records that touch each tile, in the order of primitives and without atomics.
//
// - Set-up has counted the records of each chunk of primitives that touch each tile. `prefix` turns the
//   counts into positions in one list, and `scatter` writes it: a tile's records are contiguous, chunk after
//   chunk.
// - A batch of few records has no lists, nor does one whose lists would be too long. records.cl then tests
//   all boxes.

SINGLE prefix(ulong address) {
    global const Batch *batch = AT(const Batch, address);
    global uint *counts = AT(uint, batch->counts), *starts = AT(uint, batch->starts);
    const int tiles = batch->tiles, chunks = batch->chunks;
    for (int tile = 0; tile <= tiles; ++tile) starts[tile] = 0;
    for (int chunk = 0; chunk < chunks; ++chunk, counts += tiles)
        for (int tile = 0; tile < tiles; ++tile) {
            uint count = counts[tile];
            counts[tile] = starts[tile];
            starts[tile] += count;
        }
    uint sum = 0;
    for (int tile = 0; tile < tiles; ++tile) {
        uint count = starts[tile];
        starts[tile] = sum;
        sum = add_sat(sum, count);
    }
    starts[tiles] = sum;
}

SINGLE scatter(ulong address) {
    global const Batch *batch = AT(const Batch, address);
    const int chunk = spread_work(get_global_id(0), batch->chunks), tiles = batch->tiles;
    const int tiles_x = batch->tiles_x;
    global uint *counts = AT(uint, batch->counts) + (long)chunk * tiles, *starts = AT(uint, batch->starts);
    global uint *list = AT(uint, batch->list), *boxes = AT(uint, batch->boxes);
    if (starts[tiles] > batch->list_size) return;
    for (int tile = 0; tile < tiles; ++tile) counts[tile] += starts[tile];
    int record = chunk * batch->chunk_records, end = record + AT(const uint, batch->survivors)[chunk];
    for (; record < end; ++record) {
        uint box = boxes[record];
        int x0 = box & 255u, y0 = box >> 8 & 255u, x1 = box >> 16 & 255u, y1 = box >> 24;
        for (int row = y0; row <= y1; ++row)
            for (int column = x0; column <= x1; ++column) list[counts[row * tiles_x + column]++] = record;
    }
}
