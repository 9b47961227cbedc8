// Where the constants of a garment lie in memory: an array for each name of names.ts.
export * from "./names";
import { ARRAYS, NUMBERS } from "./names";

const places: usize = memory.data(4 * 64, 16), lengths: usize = memory.data(4 * 64, 16);

// Room for an array of count numbers, of as many bytes; it is filled by the caller.
export function reserve(name: i32, count: i32, bytes: i32): usize {
  assert(name < ARRAYS);
  const place = heap.alloc(<usize>bytes + 64); // rows of four may reach behind the end
  store<usize>(places + (<usize>name << 2), place);
  store<i32>(lengths + (<usize>name << 2), count);
  return place;
}

@inline export function at(name: i32): usize { return load<usize>(places + (<usize>name << 2)); }
@inline export function reserved(name: i32): i32 { return load<i32>(lengths + (<usize>name << 2)); }
@inline export function constant(name: i32): f32 { return load<f32>(at(NUMBERS) + (<usize>name << 2)); }
