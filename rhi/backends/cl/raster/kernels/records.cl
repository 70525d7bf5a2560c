// The records of a tile: an iterator over them, and what all steps of rasterisation need of one.

#define LANE_X (int16)(0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3)
#define LANE_Y (int16)(0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3)
#define LANE_FX (float16)(0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3)
#define LANE_FY (float16)(0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3)
#define AHEAD 12  // records to prefetch: memory latency divided by the time of a record

// The tile of a work-item.
typedef struct {
    global const Batch *batch;
    int x, y;           // its first texel
    int width, height;  // the part of it inside the target, in texels, rounded up to whole blocks
} Tile;

// Iterator over the records of a tile: those in its list, or without lists those whose boxes contain it.
typedef struct {
    global const uint *list, *boxes, *survivors;
    uint next, end, chunk, chunks, chunk_records, column, row;
} Records;

INLINE void begin_records(global const Batch *batch, int tile, Records *records) {
    global const uint *starts = AT(const uint, batch->starts);
    bool listed = batch->listed && starts[batch->tiles] <= batch->list_size;
    records->list = listed ? AT(const uint, batch->list) : 0;
    records->boxes = AT(const uint, batch->boxes);
    records->survivors = AT(const uint, batch->survivors);
    records->next = listed ? starts[tile] : 0;
    records->end = listed ? starts[tile + 1] : 0;
    records->chunk = 0;
    records->chunks = listed ? 0 : batch->chunks;
    records->chunk_records = batch->chunk_records;
    records->column = tile % batch->tiles_x;
    records->row = tile / batch->tiles_x;
}

// Return the index of the next record, or -1.
INLINE int next_record(Records *records) {
    for (;;) {
        if (records->next < records->end) {
            uint index = records->next++;
            if (records->list) return records->list[index];
            uint box = records->boxes[index];
            if ((box & 255u) <= records->column && records->column <= (box >> 16 & 255u) &&
                (box >> 8 & 255u) <= records->row && records->row <= box >> 24)
                return index;
        } else {
            if (records->chunk == records->chunks) return -1;
            records->next = records->chunk * records->chunk_records;
            records->end = records->next + records->survivors[records->chunk++];
        }
    }
}

// Prefetch a later record of the tile's list.
INLINE void prefetch_record(const Records *records, global const int *record_memory) {
    if (!records->list) return;
    uint later = records->list[min(records->next + AHEAD, records->end - 1)];
    PREFETCH(record_memory + (long)later * 16);
}

// A record at a tile. Depth is a plane from texel box_x, box_y on.
typedef struct {
    global const int *words;
    int flags, kind, front;
    int box_x, box_y;                      // first texel of the record's box
    int first_x, first_y, last_x, last_y;  // that box, cut by the viewport and the scissor
    int x0, y0, x1, y1;  // the part of it in the tile; x0 and y0 are rounded down to whole blocks
    bool thin;
    bool is_rare;           // whether it needs `Rare` (edges.cl)
    float lowest, highest;  // range of the corners' depths
    float depth_x, depth_y, depth_start;
    float16 lane_depth;                              // increments of depth for the texels of a block
    global const float *planes;                      // for shading
    global const uint *corner0, *corner1, *corner2;  // their varyings
} Record;

// Read a record's flags and box.
INLINE void load_box(const Tile *tile, global const Draw *draws, global const int *words, Record *record) {
    const int flags = words[FLAGS], first = words[BOX_FIRST], last = words[BOX_LAST];
    record->words = words;
    record->flags = flags;
    record->kind = flags & 3;
    record->front = flags >> 2 & 1;
    record->thin = flags & THIN;
    record->is_rare = record->kind >= POLYGON || record->thin;
    record->first_x = record->box_x = first & 0xFFFF;
    record->first_y = record->box_y = first >> 16;
    record->last_x = last & 0xFFFF;
    record->last_y = last >> 16;
    if (flags & CUTS) {
        global const int *view_box = AT(const View, tile->batch->views)[draws[flags >> 5].view].box;
        record->first_x = max(record->first_x, view_box[0]);
        record->first_y = max(record->first_y, view_box[1]);
        record->last_x = min(record->last_x, view_box[2]);
        record->last_y = min(record->last_y, view_box[3]);
    }
    record->x0 = max(record->first_x, tile->x) & ~3;
    record->y0 = max(record->first_y, tile->y) & ~3;
    record->x1 = min(record->last_x, tile->x + TILE - 1);
    record->y1 = min(record->last_y, tile->y + TILE - 1);
}

// Read a record's depth as a plane. A thin triangle's is constant here: `thin_depth` computes it.
INLINE void load_depth_plane(const Tile *tile, Record *record) {
    global const float *plane = (global const float *)(record->words + DEPTH_PLANE);
    const bool thin = record->thin;
    record->lowest = as_float(record->words[LOWEST]);
    record->highest = as_float(record->words[HIGHEST]);
    record->depth_x = thin ? 0.0f : plane[0];
    record->depth_y = thin ? 0.0f : plane[1];
    record->depth_start = !thin ? plane[2] : tile->batch->near_is_less ? record->lowest : record->highest;
    record->lane_depth = fma((float16)(record->depth_x), LANE_FX, record->depth_y * LANE_FY);
}

// The draw of the current record, with its state.
typedef struct {
    int number;
    global const View *view;
    global const uint *state;
    global const ulong *bindings;  // its row of bound words
    ulong stage;                   // address of the fragment stage, in kernels that call it by its address
    ulong counter;                 // of samples: address relative to the batch's `counters`; 0: none
    int16 passed;                  // samples of each lane that the counter hasn't been given yet
} CurrentDraw;

// Add the samples that each lane has passed to a counter, if there is one.
INLINE void count_samples(global const Batch *batch, const CurrentDraw *draw) {
    uint count = draw->counter ? reduce_add(draw->passed) : 0;
    if (!count) return;
    volatile global uint *counter = AT(volatile uint, batch->counters + draw->counter);
    if (atomic_add(counter, count) + count < count) atomic_inc(counter + 1);
}

// Go on with the draw of another record.
INLINE void change_draw(
    global const Batch *batch, global const Draw *draws, int number, CurrentDraw *current
) {
    global const Draw *draw = draws + number;
    current->number = number;
    current->view = AT(const View, batch->views) + draw->view;
    current->state = current->view->state;
    current->bindings = AT(const ulong, batch->bindings) + (long)draw->binding_index * batch->binding_words;
    if (draw->samples == current->counter) return;
    count_samples(batch, current);
    current->counter = draw->samples;
    current->passed = (int16)(0);
}
