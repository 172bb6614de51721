// What the router shows: one view at a time.

export interface View {
  /** The browser tab's title. */
  title: string;
  element: HTMLElement;
  /** End what the view does in the background. */
  leave(): void;
}
